// The report of one run: what was stored, how it went, how well the twins fit, what was skipped and why.

import { get } from './api.js'
import { actOnRun, actor, confirm, only } from './actions.js'
import { beginButton } from './begin.js'
import { changing } from './changing.js'
import { chart } from './chart.js'
import { contactsTable, fitTable } from './contacts.js'
import { el, fill, link, pane, renew, say, select } from './dom.js'
import { fold } from './fold.js'
import { about, age, count, countOf, counted, fixed, moment, percent, plain, span } from './format.js'
import { history } from './history.js'
import { live } from './live.js'
import { eventChoice, eventRow, kindsThatMatter, matters } from './log.js'
import { medianChart, medians } from './medians.js'
import { isActive, largest, perHour, runSentence, runTone } from './runwords.js'
import { save } from './save.js'
import { sensor } from './skin.js'
import { table } from './table.js'
import { COLOURINGS, tourMap } from './tourmap.js'

const EVENTS = 200
const quiet = promise => promise.catch(() => null)

/** Everything that a report or a comparison needs of a run; parts without an answer are null. */
export async function facing(id, signal) {
  const summary = await get(`/runs/${encodeURIComponent(id)}/summary`, {}, { signal })
  const { run } = summary
  const more = { signal, wait: 20_000 }
  const [progress, fit] = await Promise.all([
    quiet(get(`/runs/${run.scan_id}/progress`, {}, more)),
    quiet(get(`/runs/${run.uid}/evaluation/simulation`, {}, more)),
  ])
  return { run, summary, progress, fit }
}

/** Makes the report into `root`. `state` is the address, `set` changes it; `others` are runs to compare with. */
export function report(root, { state, set, go, said, others, signal }) {
  let data = null
  let tour = null
  let shape = null
  const label = () => data?.run.label ?? ''
  const top = el('section')
  const contacts = el('section')
  const fits = el('section')
  const forces = el('section')
  const skips = el('section')
  const log = el('section')
  const text = el('section')
  const n = state.run
  const course = history({ title: 'Its course', state, set, signal, label })
  const map = tourMap({
    signal,
    label,
    query: () => `/api/v1/runs/${n}/progress`,
    href: configuration => `/trials?run=${n}&configuration=${configuration}`,
    onselect: index => set({ step: index }),
    forceLimit: () => live.status?.rig.force_limit_n ?? null,
  })
  const colouring = select(COLOURINGS, state.colour ?? 'force', colour => set({ colour }), { id: 'colouring' })
  const skin = pane(map.node)
  map.beside(el('label', { className: 'inline' }, 'Colour', colouring))
  const each = { time: false, whole: true, x: 'Step of the tour', height: 200, signal, label, query: `/api/v1/runs/${n}/progress` }
  const force = chart({
    ...each,
    title: 'Largest force by configuration',
    key: 'force',
    y: 'Force',
    unit: 'N',
    series: [{ name: 'largest force', digits: 1, points: true, line: false, colour: '--c3' }],
  })
  const fvu = chart({
    ...each,
    title: 'FVU by configuration, median of its trials',
    key: 'fvu',
    y: 'FVU',
    series: [{ name: 'median FVU', digits: 3, points: true, line: false, colour: '--c2' }],
    range: (_, high) => [0, Math.max(0.1, (high ?? 0) * 1.08)],
  })
  const byStep = el('section', {}, el('div', { className: 'pair' }, force.node, fvu.node))
  fill(root,
    top,
    contacts,
    el('div', { className: 'columns two' }, skin, el('div', { className: 'column' }, forces, fits)),
    course.node,
    byStep,
    el('div', { className: 'columns two' }, skips, log),
    text,
  )
  fill(top, el('p', { className: 'soft' }, 'Loading …'))

  // While the run is active it is read again and again: what a person has opened or chosen stays.
  const told = el('p')
  const numbers = el('div')
  const doors = el('div', { className: 'row' })
  const abort = run =>
    actor('Abort', said, () => actOnRun(run.uid, 'abort').finally(() => quiet(read())), {
      role: 'viewer',
      what: `Abort run ${run.scan_id}`,
      sure: () => confirm(`Abort run ${run.scan_id}?`, 'It ends. Its stored trials stay; it can be resumed later. Nothing moves.', 'Abort the run'),
    })
  function heading(run) {
    const rest = others().filter(other => other.scan_id !== run.scan_id).map(other => [other.scan_id, `${other.scan_id} ${other.experiment}`])
    const open = other => other && go(`/runs?run=${run.scan_id}&with=${other}`)
    const compare = select([['', 'another run …'], ...rest], '', open, { id: 'compare' })
    return [
      el('h2', {},
        el('span', {}, `Run ${run.scan_id}, ${run.experiment}`),
        run.label === 'virtual' ? el('span', { className: 'badge' }, 'virtual') : plain(run.label),
      ),
      told,
      numbers,
      doors,
      others().length > 1 ? el('p', { className: 'row' }, el('label', { className: 'inline', htmlFor: 'compare' }, 'Compare with'), compare) : null,
      said.node,
    ]
  }
  function header() {
    const { run, summary, progress, fit } = data
    const rate = perHour(summary)
    renew(top, run.uid, () => heading(run))
    say(told, runSentence(run)).className = `big ${runTone(run)}`
    changing(numbers, [
      ['Stored', countOf(summary.trials_stored, run.trials_planned)],
      ['Share', percent(summary.trials_stored, run.trials_planned)],
      ['Skipped configurations', count(summary.skips.length)],
      ['Trials of these', count(summary.trials_skipped)],
      ['Failed attempts', count(summary.retries)],
      ['Duration', span(summary.duration_s ?? (isActive(run) ? age(run.started_at) : null))],
      rate != null && ['Trials per hour', count(Math.round(rate))],
      ['Largest force', fixed(largest(progress?.largest_force_n), 1, 'N')],
      ['Median FVU', about(fit?.median_fvu)],
      ['Began', moment(run.started_at)],
      run.ended_at && ['Ended', moment(run.ended_at)],
      ['Submitted by', run.submitted_by],
      ['Kind', run.kind],
      run.seed != null && ['Seed', String(run.seed)],
      ['Version', run.version],
      run.git_commit && ['Commit', run.git_commit.slice(0, 8)],
    ])
    renew(doors, [run.is_resumable, run.state, isActive(run)], () => [
      run.is_resumable && [beginButton('Resume', run, said, { after: read, className: 'main' }), run.state === 'interrupted' && abort(run)],
      isActive(run) && link('/', 'Watch it'),
      link(`/trials?run=${run.scan_id}`, 'Its trials'),
      run.plan_sha256 && link(`/plan?run=${run.scan_id}`, 'Its plan'),
      link(`/model?run=${run.scan_id}`, 'Fit of the simulation'),
      link('/data', 'Datasets'),
      link('/data#exports', 'Export'),
      save('Parquet', `/api/v1/data/run-${run.scan_id}.parquet`, `run-${run.scan_id}.parquet`),
      save('CSV', `/api/v1/data/run-${run.scan_id}.csv`, `run-${run.scan_id}.csv`),
    ])
  }

  function tables() {
    const { run, summary, fit } = data
    const noun = run.kind === 'real-random' ? 'weight' : 'tip'
    const bySetting = summary.settings.map(s => `${counted(s.tips, noun)} ${count(s.stored)}`).join(', ')
    renew(contacts, [summary.contact_counts, bySetting], () => [
      el('h2', {}, 'Contacts'),
      contactsTable([{ name: `Run ${run.scan_id}`, kind: run.kind, counts: summary.contact_counts }]),
      el('p', { className: 'soft said' }, `By setting: ${bySetting || 'none'}. Deadband ${fixed(run.deadband_n, 1, 'N')}.`),
    ])
    const more = link(`/model?run=${run.scan_id}`, 'More')
    renew(fits, fit, () => [el('h2', {}, el('span', {}, 'Fit of the twins by contacts'), more), fitTable([{ name: '', fit }])])
    renew(skips, summary.skips, () => [
      el('h2', {}, 'Skipped configurations'),
      table({
        rows: summary.skips,
        empty: 'None was skipped.',
        href: row => `/trials?run=${run.scan_id}&configuration=${row.configuration}`,
        columns: [
          { head: 'Configuration', left: true, cell: row => count(row.configuration) },
          { head: 'When', cell: row => moment(row.at, true) },
          { head: 'Reason', left: true, cell: row => row.reason },
        ],
      }).node,
    ])
    renew(text, run.definition, () => [
      fold('experiment', 'Experiment file', { signal }, el('pre', { tabIndex: 0 }, run.definition)),
      run.state !== 'removed' && run.kind !== 'imported' ? only('operator', el('p', { className: 'said' }, link(`/queue?copy=${run.scan_id}`, 'Queue a copy of it'))) : null,
    ])
  }

  const choice = eventChoice(state, set)
  const list = el('div')
  fill(log, el('h2', {}, el('span', {}, 'Events'), choice), list)
  async function events() {
    const all = state.log === 'all'
    const page = await quiet(get('/events', { run: n, kind: all ? null : kindsThatMatter(), since: -EVENTS, limit: EVENTS }, { signal }))
    if (signal.aborted || all !== (state.log === 'all')) return
    const items = (page?.items ?? []).filter(event => all || matters(event)).reverse()
    const scrolled = list.firstChild?.scrollTop ?? 0
    renew(list, [page == null, items.map(event => event.seq)], () =>
      items.length
        ? el('ol', { className: 'events scroll', tabIndex: 0, ariaLabel: 'Events of the run, newest first' }, items.map(eventRow))
        : el('p', { className: 'soft' }, page ? all ? 'No events.' : 'No important events.' : 'The events could not be read.'),
    )
    if (list.firstChild) list.firstChild.scrollTop = scrolled
  }

  async function read() {
    data = await facing(n, signal)
    if (signal.aborted) return
    header()
    tables()
    const { run, progress } = data
    tour ??= await quiet(get(`/runs/${run.scan_id}/tour`, {}, { signal, wait: 30_000 }))
    shape ??= await quiet(sensor(run.scan_id))
    if (signal.aborted) return
    // What is read again and again is old without a connection.
    for (const part of [top, contacts, fits, skips, log, skin, byStep]) part.classList.toggle('live', isActive(run))
    skin.hidden = !tour || !shape
    byStep.hidden = !progress
    if (!skin.hidden) {
      map.colouring(state.colour ?? 'force')
      map.set(tour, progress, shape, !isActive(run))
      map.choose(state.step == null ? null : Number(state.step))
    }
    if (progress) {
      const steps = progress.stored.map((_, i) => i + 1)
      force.set([steps, progress.largest_force_n])
      fvu.set([steps, progress.fvu])
    }
    course.node.hidden = run.started_at == null
    if (run.started_at)
      course.show(run, {
        endedAt: run.ended_at ? Date.parse(run.ended_at) : null,
        eta_s: live.status?.run?.uid === run.uid ? live.status.run.eta?.remaining_s : null,
      })
  }

  async function once() {
    await read()
    await events()
    const found = await quiet(medians(data.run, signal))
    if (signal.aborted) return
    const view = found && medianChart([{ name: '', tips: found }], { label, signal, query: `/api/v1/runs/${n}/forces` })
    fill(forces,
      view
        ? view.node
        : [
            el('h2', {}, 'Force over depth'),
            el('p', { className: 'soft' }, !found ? 'The forces could not be read.' : data.run.kind === 'real-random' ? 'Weights have no depth.' : 'No trial with a depth is stored.'),
          ],
    )
  }

  return {
    open: once,
    refresh: () => (data && isActive(data.run) ? quiet(read().then(events)) : null),
    update(next) {
      const logged = next.log !== state.log
      state = next
      colouring.value = next.colour ?? 'force'
      choice.value = next.log ?? ''
      map.colouring(next.colour ?? 'force')
      map.choose(next.step == null ? null : Number(next.step))
      course.update(next)
      if (logged) events()
    },
  }
}
