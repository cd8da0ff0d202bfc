// Plan: what will a run do, and what prevents it? The tour on the skin, time by activity, forces, disk, and
// what is refused and why. `run=N` is a stored run, `experiment=NAME` one that the program carries.

import { get, send } from '../lib/api.js'
import { actor, only, outcome } from '../lib/actions.js'
import { beginButton, queueText } from '../lib/begin.js'
import { carried, carriedTable } from '../lib/carried.js'
import { el, every, fill, link, pane, panel, say, select } from '../lib/dom.js'
import { forcesPanel } from '../lib/expected.js'
import { fold } from '../lib/fold.js'
import { capital, counted, fixed, moment, span } from '../lib/format.js'
import { isActive, runSentence } from '../lib/runwords.js'
import { live, rigLabel } from '../lib/live.js'
import { NEEDS_OPERATOR, partsBar, planFacts, problemList, settingsTable } from '../lib/preflight.js'
import { submittedTour } from '../lib/submitted.js'
import { sensor } from '../lib/skin.js'
import { tourView } from '../lib/tour.js'

const ENDED = ['ended', 'removed']
const FIRST_ANSWER_MS = 1500
const EVERY_MS = 5000
const settled = promise =>
  promise.then(p => ({ p }), error => ({ error }))

/** Shows the page. */
export async function show(root, { query, signal, go, set }) {
  let shown = ''
  let state = query
  let tour = null
  let view = null
  let geometry = null
  let current = null // The stored run that is shown.
  let checked = null
  const said = outcome()
  const told = el('p')

  async function open(query) {
    state = query
    const wanted = `${query.run ?? ''} ${query.experiment ?? ''}`
    if (wanted === shown) return turn(query)
    shown = wanted
    tour = view = current = null
    fill(root, panel('Plan', {}, el('p', { className: 'soft' }, 'Loading …')))
    const chosen = await choose(query)
    if (signal.aborted || wanted !== shown) return undefined
    if (!chosen) return empty()
    // Another address may be asked for before all is read.
    const isOver = () => signal.aborted || wanted !== shown
    return chosen.run ? planned(chosen.run, query, isOver) : offered(chosen.item, query, isOver)
  }

  /** The run or the carried experiment of the address, else the next run of the queue, else the active or newest one. */
  async function choose({ run, experiment }) {
    if (experiment) return { item: (await carried()).find(item => item.name === experiment) ?? { name: experiment } }
    if (run) return { run: await get(`/runs/${encodeURIComponent(run)}`, {}, { signal }) }
    const next = (await get('/queue', {}, { signal })).items[0]
    if (next) return { run: next }
    const [newest] = (await get('/runs', { limit: 1 }, { signal })).items
    return live.status?.run ? { run: await get(`/runs/${live.status.run.uid}`, {}, { signal }) } : newest && { run: newest }
  }

  const choices = () => carriedTable(item => `/plan?experiment=${encodeURIComponent(item.name)}`)
  async function empty() {
    fill(root, panel('No plan yet', {}, el('p', {}, 'No run is queued or stored. Choose an experiment to see what it will do.'), await choices()))
  }

  async function offered(item, query, isOver) {
    if (!item.text) return fill(root, panel(item.name, {}, el('p', { className: 'bad' }, `The program carries no experiment ${item.name}.`), await choices()))
    await first('caller', () => live.caller)
    checked = live.may('operator')
    const submission = { file: item.file, definition: item.text }
    const asked = checked ? [send('/preflight', submission, { signal }), submittedTour(submission, signal)] : []
    const [answer = {}, made] = await Promise.all(asked.map(settled))
    if (isOver()) return undefined
    tour = made?.p ?? null
    geometry = tour?.sensor ?? null
    const add = async () => go(`/plan?run=${(await queueText(item.file, item.text)).scan_id}`)
    const queue = actor('Queue it', said, add, { className: 'main', disabled: !answer.p || answer.p.problems.length > 0 })
    const words = pane(
      el('h2', {}, el('span', {}, item.name), link('/plan', 'The next run')),
      el('p', {}, item.about),
      el('p', { className: 'soft' }, 'It is not queued. This is what it would do on this rig.'),
      verdict(answer),
      el('div', { className: 'row' }, queue, only('operator', link(`/queue?add=${encodeURIComponent(item.name)}`, 'Change it first'))),
      said.node,
      fold('file', 'Experiment file', { signal }, el('pre', { tabIndex: 0 }, item.text)),
    )
    const picture = made && el('section', {}, drawing({ label: rigLabel, absent: `The service has no tour of it: ${made.error?.message}.` }, query))
    const [others, parts] = [panel('Others', {}, await choices()), await details(answer.p)]
    if (isOver()) return undefined
    return fill(root, el('div', { className: 'columns two' }, el('div', { className: 'column' }, words, picture, others), parts))
  }

  function verdict({ p, error }) {
    if (!p && !error) return el('p', { className: 'soft' }, NEEDS_OPERATOR)
    const errors = error?.problem?.errors
    const refused = (words, problems) => el('div', {}, el('p', { className: 'bad' }, words), problemList(problems))
    if (error) return refused(errors ? 'The experiment file is refused:' : capital(`${error.message}.`), errors ?? [])
    if (p.problems.length) return refused('This bench cannot run it:', p.problems)
    return el('p', { className: 'good' }, 'This bench can run it.')
  }

  async function planned(run, query, isOver) {
    current = run
    const [answer, drawn, shape] = await Promise.all([
      settled(get(`/runs/${run.uid}/preflight`, {}, { signal, wait: 20_000 })),
      get(`/runs/${run.scan_id}/tour`, {}, { signal, wait: 30_000 }).catch(() => null),
      sensor(run.scan_id).catch(() => null),
    ])
    if (isOver()) return
    tour = drawn
    geometry = shape
    const waits = run.state === 'queued' || run.is_resumable
    const may = answer.p && !answer.p.problems.length
    const after = started => started && again()
    const start = beginButton(run.state === 'queued' ? 'Arm and start' : 'Resume', run, said, { after, className: 'main', disabled: !may })
    const facing = pane(
      el('h2', {}, el('span', {}, `Run ${run.scan_id}, ${run.experiment}`), run.label === 'virtual' ? el('span', { className: 'badge' }, 'virtual') : ''),
      say(told, standing(run)),
      waits || answer.error ? verdict(answer) : null,
      el('div', { className: 'row' },
        waits && !run.waiting_since && start,
        run.state === 'queued' && only('operator', link(`/queue?edit=${run.scan_id}`, 'Edit')),
        run.kind !== 'imported' && only('operator', link(`/queue?copy=${run.scan_id}`, 'Copy it')),
        ENDED.includes(run.state) && link(`/runs?run=${run.scan_id}`, 'Its results'),
        link('/queue', 'The queue'),
      ),
      said.node,
    )
    facing.classList.add('live')
    const label = () => run.label
    const absent = run.kind === 'imported' ? 'An imported run has no plan.' : 'The service has no tour of this run.'
    const picture = el('section', {}, drawing({ label, absent, source: `/api/v1/runs/${run.scan_id}/tour` }, query))
    const parts = await details(answer.p)
    if (!isOver()) fill(root, el('div', { className: 'columns two' }, el('div', { className: 'column' }, facing, picture), parts))
  }

  function standing(run) {
    if (run.state === 'queued') {
      const early = run.not_before ? `, to start at ${moment(run.not_before)} or later` : ''
      const next = run.waiting_since ? 'It is started and waits for its turn.' : 'It begins when a person arms and starts it.'
      return `Queued by ${run.submitted_by}, ${moment(run.created_at)}, in place ${run.queue_position}${early}. ${next}`
    }
    return `${runSentence(run)}${run.kind === 'imported' ? '' : ' Durations are those of the whole plan on the present rig.'}`
  }

  /** The tour on its skin, or `absent`; `source` is the address of a stored one. */
  function drawing({ label, absent, source }, query) {
    if (!tour) return el('p', { className: 'soft' }, absent)
    if (!geometry) return el('p', { className: 'soft' }, 'The service does not describe the sensor of this run, so the skin cannot be drawn.')
    const counts = [...new Set(tour.steps.tips)]
    view = tourView({ onstep: step => set({ step: step || null }), label, query: source, signal })
    turn(query)
    if (counts.length < 2) return view.node
    const choices = [['', 'all settings'], ...counts.map(n => [n, counted(n, tour.kind === 'real-random' ? 'weight' : 'tip')])]
    const choice = select(choices, query.tips ?? '', tips => set({ tips: tips || null, step: null }))
    return [el('p', { className: 'row' }, el('label', { className: 'inline' }, 'Setting', choice)), view.node]
  }

  let setting = null
  function turn(query) {
    if (!view) return
    const next = `${shown} ${query.tips ?? ''}`
    const step = query.step == null ? null : Number(query.step)
    if (setting === next && step != null && view.seen) return view.go(step)
    setting = next
    view.seen = true
    view.show(tour, geometry, { tips: query.tips ? Number(query.tips) : null, step })
  }

  async function details(p) {
    await first('status', () => live.status)
    const forces = forcesPanel({ p, tour })
    if (!p) return el('div', { className: 'column' }, forces)
    const rate = live.status?.rig.clock_rate ?? 1
    const real = `The clock of this virtual rig runs ${fixed(rate, 0)} times faster: a real one takes about ${span(p.duration_s * rate)}.`
    const speed = rate === 1 ? null : el('p', { className: 'soft' }, real)
    const parts = [panel('What it takes', {}, planFacts(p), speed), panel('Time by activity', {}, partsBar(p.parts)), panel('Settings', {}, settingsTable(p))]
    return el('div', { className: 'column' }, parts, forces)
  }

  const failed = error => {
    shown = '' // The same address may be tried again.
    const words = el('p', { className: 'bad' }, capital(`${error.message}.`))
    if (!signal.aborted) fill(root, panel('Plan', {}, words, link('/plan', 'The next run')))
  }
  const update = next => open(next).catch(failed)
  function again() {
    shown = ''
    return update(state)
  }
  // Another key may check what the present one may not, and the other way round.
  const checks = () => state.experiment && checked != null && checked !== live.may('operator') && again()
  live.addEventListener('caller', checks, { signal })
  // Another person may begin, edit or remove the run that is shown: it is read again whenever the rig or the queue changes,
  // and while it is queued again and again, because an edit changes neither.
  const planOf = run => [run.state, run.waiting_since, run.definition_sha256, run.sensor_sha256].join()
  async function follow() {
    const of = current
    const found = of && (await get(`/runs/${of.uid}`, {}, { signal }).catch(() => null))
    if (!found || of !== current) return
    if (planOf(found) !== planOf(of) && !(isActive(found) && isActive(of))) return void again()
    current = found
    say(told, standing(found))
  }
  live.onChange(({ run, queue_length }) => `${run?.uid} ${run?.state} ${queue_length}`, follow, signal)
  every(EVERY_MS, () => current?.state === 'queued' && follow(), signal)
  await update(query)
  return { update }
}

/** Waits shortly for the first event of a kind: limits and speed of the rig come with the status, the role with the caller. */
const first = (kind, known) =>
  known() ??
  new Promise(resolve => {
    live.addEventListener(kind, resolve, { once: true })
    setTimeout(resolve, FIRST_ANSWER_MS)
  })
