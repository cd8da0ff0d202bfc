// Runs: what happened? The history, newest first, by the conditions of the address, as `exit_status=fail`; `run=N` opens the
// report of one, `with=M` compares two.

import { get, withQuery } from '../lib/api.js'
import { outcome } from '../lib/actions.js'
import { beginButton } from '../lib/begin.js'
import { compare } from '../lib/compare.js'
import { el, every, fill, link, panel, replacing, select, sleep } from '../lib/dom.js'
import { NONE, age, count, counted, listed, moment, span } from '../lib/format.js'
import { listing } from '../lib/listing.js'
import { live } from '../lib/live.js'
import { report } from '../lib/report.js'
import { BEGUN, STATES, endWord, runTone } from '../lib/runwords.js'
import { chips, conditions } from '../lib/selection.js'
import { table } from '../lib/table.js'

const PAGE = 50
const AT_ONCE = 3
const EVERY_MS = 10_000
// With one of these in the address, runs that have not begun are listed, too.
const ON_STATE = /^(state|exit_status|scan_id|where)(__|$)/
const lasted = (summary, run) => span(summary.duration_s ?? (run.state === 'interrupted' ? null : age(run.started_at)))

/** Shows the page. */
export async function show(root, { query, signal, go, set }) {
  const said = outcome()
  const summaries = new Map()
  const list = el('div', { className: 'list' })
  const body = el('div', { className: 'list' })
  const known = listing('/runs', { words: 'The runs', draw, limit: PAGE, key: run => run.uid, signal })
  let selected = ''
  let opened = ''
  let view = null
  const opening = replacing(signal)
  root.append(list, body)

  // The list.
  const cells = new Map()
  const told = el('p', { className: 'soft' })
  // What the summary of a run states: it is read after the list, and later than it.
  const SUMMED = { stored: s => count(s.trials_stored), skips: s => count(s.skips.length), retries: s => count(s.retries), duration: lasted }
  const cell = (run, name) => {
    const key = `${run.uid} ${name}`
    if (!cells.has(key)) cells.set(key, el('span', {}, NONE))
    const found = summaries.get(run.uid)
    if (found) cells.get(key).textContent = SUMMED[name](found, run)
    return cells.get(key)
  }
  const end = run =>
    run.is_resumable
      ? el('span', { className: 'row tight' }, el('span', { className: runTone(run) }, run.reason ?? 'interrupted'), resume(run))
      : el('span', { className: runTone(run) }, endWord(run), run.reason && run.exit_status !== 'success' ? `: ${run.reason}` : '')
  function resume(run) {
    return beginButton('Resume', run, said, { after: refresh, 'aria-label': `Resume run ${run.scan_id}` })
  }
  const rows = table({
    href: run => withQuery('/runs', { ...kept(), run: run.scan_id }),
    empty: 'No run is in this selection.',
    columns: [
      { head: 'Run', left: true, cell: run => `${run.scan_id} ${run.experiment}` },
      { head: 'Data', left: true, cell: run => el('span', { className: run.label === 'virtual' ? 'virtual' : '' }, run.label) },
      { head: 'Kind', left: true, cell: run => run.kind },
      { head: 'Began', cell: run => moment(run.started_at) },
      { head: 'By', left: true, cell: run => run.submitted_by },
      { head: 'Stored', cell: run => el('span', {}, cell(run, 'stored'), ` of ${count(run.trials_planned)}`) },
      { head: 'Skipped', cell: run => cell(run, 'skips') },
      { head: 'Failed attempts', cell: run => cell(run, 'retries') },
      { head: 'Duration', cell: run => cell(run, 'duration') },
      { head: 'End', left: true, cell: end },
    ],
  })
  rows.node.classList.add('stack')
  const other = id => value => set({ [id]: value || null })
  const controls = {
    state: select(STATES, '', value => {
      const [key, wanted] = value.split('=')
      set({ state: null, state__in: null, exit_status: null, scan_id__gte: null, ...(key && { [key]: wanted }) })
    }, { id: 'state' }),
    kind: select([['', 'any'], 'real-hex', 'real-random', 'imported'], '', other('kind'), { id: 'kind' }),
    label: select([['', 'any'], 'measured', 'virtual', 'simulated'], '', other('label'), { id: 'label' }),
  }
  const choice = (id, words) => el('span', { className: 'filter' }, el('label', { className: 'inline', htmlFor: id }, words), controls[id])
  const others = el('span', { className: 'chips', role: 'group', 'aria-label': 'Conditions' })
  const filters = el('div', { className: 'row' }, choice('state', 'Runs'), choice('kind', 'Kind'), choice('label', 'Data'), others)
  list.append(panel('History', { className: 'live' }, filters, known.trouble, told, rows.node, el('div', { className: 'row' }, known.more)))
  const kept = () => conditions(query, 'runs')

  let unknown = []
  let working = 0
  function draw() {
    const { items: runs, next } = known
    const given = Object.entries(kept())
    const isWhole = !given.length
    const [state = ''] = STATES.find(([value]) => value && given.some(pair => pair.join('=') === value)) ?? []
    for (const [id, control] of Object.entries(controls)) control.value = id === 'state' ? state : (query[id] ?? '')
    const rest = given.filter(pair => pair.join('=') !== state && !['kind', 'label'].includes(pair[0]))
    fill(others, rest.length > 0 && chips(rest, given, set))
    const isUnread = !known.trouble.hidden && !runs.length
    if (isUnread) fill(told)
    else if (!runs.length && isWhole) fill(told, 'No run has begun yet. ', link('/queue', 'Queue one'), ' to begin.')
    else fill(told, runs.length > 0 && `${next ? 'The newest ' : ''}${counted(runs.length, 'run')}, newest first.`)
    rows.node.hidden = isUnread || (isWhole && !runs.length)
    filters.hidden = !runs.length && isWhole
    rows.show(runs)
    unknown = runs.filter(run => !summaries.has(run.uid) || !summaries.get(run.uid).run.ended_at)
    while (working < AT_ONCE && unknown.length) work()
  }
  /** Reads the results of the listed runs, one after the other. */
  async function work() {
    working += 1
    for (let run; (run = unknown.shift()) && !signal.aborted && !query.run; ) await summary(run)
    working -= 1
  }
  async function summary(run) {
    const found = await get(`/runs/${run.uid}/summary`, {}, { signal }).catch(() => null)
    if (!found) return
    summaries.set(run.uid, found)
    for (const name of Object.keys(SUMMED)) cell(run, name)
  }
  async function refresh() {
    if (signal.aborted) return
    await (query.run ? view?.refresh?.() : known.read())
  }
  /** Follows the conditions of the address. */
  function follow() {
    const given = kept()
    const text = JSON.stringify(given)
    if (text === selected) return draw()
    selected = text
    return known.select(Object.keys(given).some(key => ON_STATE.test(key)) ? given : { ...BEGUN, ...given })
  }

  // One run, or two.
  async function open() {
    const wanted = listed([query.run, query.with], ' ')
    list.hidden = Boolean(wanted)
    body.hidden = !wanted
    if (wanted === opened) return wanted ? view?.update?.(query) : follow()
    opened = wanted
    const until = opening()
    view = null
    if (!wanted) {
      fill(body)
      return follow()
    }
    const back = withQuery('/runs', kept())
    try {
      if (query.with) await compare(body, { ...query, back, signal: until })
      else {
        const inside = el('div', { className: 'list' })
        fill(body, el('section', { className: 'back' }, link(back, 'All runs')), inside)
        view = report(inside, { state: query, set, go, said, others: () => known.items, signal: until })
        await view.open()
      }
    } catch (error) {
      if (!until.aborted)
        fill(body, panel('Run', {}, el('p', { className: 'bad' }, `Run ${opened} could not be shown: ${error.message}.`), link(back, 'All runs')))
    }
    return undefined
  }

  sleep(EVERY_MS, signal).then(() => every(EVERY_MS, () => (query.run || live.status?.run) && refresh(), signal))
  live.onChange(({ run }) => `${run?.uid} ${run?.state}`, refresh, signal)
  await follow()
  open()
  return {
    update: next => {
      query = next
      return open()
    },
  }
}
