// The waiting runs: their order, predicted times, and what may be done with each. Rows are dragged or moved by buttons.

import { ask, get, send, withQuery } from './api.js'
import { actor, confirm, only } from './actions.js'
import { beginButton, startRights } from './begin.js'
import { clockline } from './clockline.js'
import { button, el, panel, say } from './dom.js'
import { NONE, capital, count, counted, listed, moment, momentBand, plain, span } from './format.js'
import { live, who } from './live.js'
import { dragRows } from './drag.js'
import { table } from './table.js'

const until = ({ end, low, high }) => momentBand(end, low, high)
const name = row => `${row.scan_id} ${row.experiment}`

function summary(run, rows, last, partial) {
  const first = run ? `Run ${run.scan_id} is ${plain(run.state)}.` : 'No run is active.'
  if (!rows.length) return `${first} Nothing waits.`
  const end = last > 0 ? `the queue ends ${partial ? 'after' : 'about'} ${moment(last)}` : 'the end is not known yet'
  return `${first} ${counted(rows.length, 'run')} ${rows.length === 1 ? 'waits' : 'wait'}; ${end}.`
}

function conditions(rows, rig) {
  const held = rows.filter(row => !row.waiting_since).length
  if (!rows.length) return ''
  const open = held === rows.length ? 'None of these runs is' : `${count(held)} of these runs ${held === 1 ? 'is' : 'are'} not`
  return listed([
    held > 0 && `${open} started yet: the times hold if each is started before its turn.`,
    'Times exclude manual work (tips, weights).',
    rig?.label === 'virtual' && 'The rig is virtual: durations are at the speed of its clock.',
  ], ' ')
}

/** Makes the panel: { node, refresh }. `said` tells what became of an action, `go` leads to the editor. */
export function waiting({ said, go, signal }) {
  const line = clockline()
  const cells = new Map()
  let rows = []
  let predicted = new Map() // By uid: times of a run, as the service predicts them, with moments in ms.
  let tag = ''
  let pressed = ''

  const head = el('p', { className: 'big' }, 'Loading …')
  const hint = el('p', { className: 'soft said' })
  const list = table({
    columns: [
      { head: 'Run', left: true, cell: name },
      { head: 'Trials', cell: row => count(row.trials_planned) },
      { head: 'Duration', cell: row => cell(row, 'duration') },
      { head: 'Begins', cell: row => cell(row, 'begins') },
      { head: 'Ends', cell: row => cell(row, 'ends') },
      { head: 'State', left: true, cell: row => cell(row, 'state') },
      { head: 'Queued by', left: true, cell: row => `${row.submitted_by}, ${moment(row.created_at)}` },
      { head: 'Change', left: true, cell: buttons },
    ],
    empty: 'Choose an experiment below, or drop an experiment file on this page.',
    href: row => `/plan?run=${row.scan_id}`,
  })
  list.node.classList.add('queue-table', 'stack')
  const drag = dragRows(list.node, { rows: () => rows, move: (row, position) => said.run(`Move run ${row.scan_id}`, () => move(row, position)) })

  function cell(row, part) {
    const key = `${row.uid} ${part}`
    if (!cells.has(key)) cells.set(key, el('span', {}, NONE))
    return cells.get(key)
  }

  function buttons(row) {
    const at = rows.indexOf(row)
    const run = `run ${row.scan_id}`
    const mine = (words, work, props) => {
      const node = actor(words, said, work, { what: `${words} ${run}`, ...props })
      node.dataset.key = `${words} ${row.uid}`
      return node
    }
    const other = (words, work, props) => only('operator', button(words, work, { 'aria-label': `${words} ${run}`, ...props }))
    return el('div', { className: 'row tight' },
      !row.waiting_since && beginButton('Arm and start', row, said, { after: refresh, className: at ? '' : 'main', 'aria-label': `Arm and start ${run}` }),
      mine('Up', () => move(row, at), { disabled: at === 0, 'aria-label': `Move ${run} up` }),
      mine('Down', () => move(row, at + 2), { disabled: at === rows.length - 1, 'aria-label': `Move ${run} down` }),
      other('Edit', () => go(`/queue?edit=${row.scan_id}`)),
      other('Copy', () => go(`/queue?copy=${row.scan_id}`)),
      mine('Remove', () => change(withQuery(`/queue/${row.uid}`, { who: who() }), undefined, 'DELETE'), {
        className: 'danger',
        'aria-label': `Remove ${run}`,
        sure: () => confirm(`Remove ${run}?`, `${row.experiment} is taken from the queue. Its number is not used again; the experiment can be queued again.`, 'Remove'),
      }),
    )
  }

  function move(row, position) {
    pressed = `${position > rows.indexOf(row) + 1 ? 'Down' : 'Up'} ${row.uid}`
    return change(`/queue/${row.uid}/move`, { position, who: who() })
  }
  /** Changes the queue if it is still as shown, and shows it as it is then. */
  async function change(path, body, method) {
    try {
      await send(path, body, { method, headers: tag ? { 'if-match': tag } : {} })
    } catch (error) {
      if (error.status === 412) error.message = 'the queue has changed since it was shown. It is shown as it is now'
      throw error
    } finally {
      await refresh()
    }
  }

  // The rows: read with the tag of what is shown, drawn again only if they changed.
  let asked = 0
  let fails = ''
  async function refresh() {
    const mine = (asked += 1)
    const isOver = () => signal.aborted || mine !== asked // What was asked later, as after a move, shows what is newer.
    try {
      const answer = await ask('/api/v1/queue', { signal, headers: tag ? { 'if-none-match': tag } : {} })
      const items = answer.status === 304 ? null : (await answer.json()).items
      if (isOver()) return
      fails = ''
      if (items) {
        tag = answer.headers.get('etag') ?? ''
        draw(items)
      }
      times()
      await predict(isOver)
    } catch (error) {
      if (isOver()) return
      fails = `The queue could not be read: ${error.message}.`
    }
    times()
  }
  function draw(next) {
    rows = next
    const focus = pressed || document.activeElement?.dataset.key // An action disables its button, which loses the focus.
    pressed = ''
    list.show(rows)
    drag.attach()
    if (focus) list.node.querySelector(`[data-key="${focus}"]`)?.focus()
  }
  async function predict(isOver) {
    const ms = text => (text == null ? null : Date.parse(text))
    let times = null
    try {
      times = await get('/queue/times', {}, { signal, wait: 30_000 })
    } catch (error) {
      if (!isOver()) fails = `The times could not be predicted: ${error.message}.`
      return
    }
    if (isOver()) return
    predicted = new Map(times.items.map(one => [one.run, { ...one, begin: ms(one.begin), end: ms(one.end), low: ms(one.low), high: ms(one.high) }]))
  }

  function stateOf(row, now) {
    const { problem, not_begun: dropped } = predicted.get(row.uid) ?? {}
    const early = row.not_before && Date.parse(row.not_before) > now ? `not before ${moment(row.not_before)}` : ''
    const bad = problem ? `refused: ${problem}` : ''
    const words = row.waiting_since ? 'started, waits for its turn' : dropped ? `does not begin by itself: ${dropped}` : 'to be started by a person'
    return { words: capital(listed([bad, words, early])), tone: bad ? 'bad' : row.waiting_since ? 'good' : 'warn' }
  }

  function times() {
    const now = Date.now()
    const { run, rig } = live.status ?? {}
    const eta = run?.eta
    for (const row of rows) {
      const t = predicted.get(row.uid)
      say(cell(row, 'duration'), t?.duration_s == null ? NONE : span(t.duration_s))
      say(cell(row, 'begins'), t?.begin == null ? NONE : moment(t.begin))
      say(cell(row, 'ends'), t?.end == null ? NONE : until(t))
      const { words, tone } = stateOf(row, now)
      say(cell(row, 'state'), words)
      cell(row, 'state').className = tone
    }
    const active = run && eta ? [{ name: name(run), href: '/', begin: now, end: now + eta.remaining_s * 1e3, tone: 'now' }] : []
    const bar = row => ({ name: name(row), href: `/plan?run=${row.scan_id}`, ...predicted.get(row.uid) })
    const bars = rows.filter(row => predicted.get(row.uid)?.begin != null).map(bar)
    line.show(now, [...active, ...bars.sort((a, b) => a.begin - b.begin)])
    const last = Math.max(0, ...[...active, ...bars].map(one => one.end))
    say(head, fails || summary(run, rows, last, rows.length > bars.length))
    head.className = `big ${fails ? 'bad' : ''}`
    say(hint, conditions(rows, rig))
  }

  live.addEventListener('caller', drag.attach, { signal })
  const node = panel('In this order', { className: 'live' }, head, line.node, list.node, said.node, hint, startRights(signal))
  return { node, refresh }
}
