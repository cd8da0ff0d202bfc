// Workers of bulk work on other machines, and their queue: orders with progress, rate, predicted end and failed chunks;
// they are submitted, cancelled and gathered here.

import { get, send } from './api.js'
import { actor, confirm, outcome } from './actions.js'
import { el, every, panel, renew, say } from './dom.js'
import { bytes, count, countOf, counted, fixed, listed, moment, NONE, plain, span } from './format.js'
import { table } from './table.js'
import { TONE } from './words.js'

const PERIOD_MS = 10_000, CHANGE_MS = 120_000
const CANCELLED = 'Its chunks leave the queue; one that is being made is completed. Results stay, and the order can be submitted again.'

/** Makes the panel of workers; it asks every ten seconds until `signal` aborts, and is hidden without a queue. */
export function workers(signal) {
  const said = outcome(), error = el('p', { className: 'bad' }), gathered = el('p', {}), failures = el('p', { className: 'warn' }),
    offered = el('div', { className: 'row soft' })
  const nameOf = row => row.folder ?? row.order.slice(0, 12), folderOf = name => `/workers/folders/${encodeURIComponent(name)}`
  const machines = table({ empty: 'No worker: palpate worker work', columns: [{ head: 'Worker', cell: row => row.worker },
    { head: 'Heard', cell: row => `${span(row.heard_s)} ago${row.lost ? ', lost' : ''}` }, { head: 'Chunks at once', cell: row => count(row.about?.at_once) },
    { head: 'Memory', cell: row => row.about?.memory_mib == null ? NONE : bytes(row.about.memory_mib * 2 ** 20) },
    { head: 'GPU', cell: row => row.about?.gpu == null ? NONE : row.about.gpu ? 'yes' : 'no' }] })
  const orders = table({ empty: 'No order: palpate cluster sbatch, then submit it', columns: [{ head: 'Order', cell: nameOf, left: true },
    { head: 'Done', cell: row => el('div', {}, el('progress', { max: row.chunks, value: row.done, 'aria-label': `Chunks done of ${nameOf(row)}` }),
      countOf(row.done, row.chunks)) },
    { head: 'Running', cell: row => count(row.running) }, { head: 'Waiting', cell: row => count(row.waiting) },
    { head: 'Failed', cell: row => count(row.failed) }, { head: 'Not submitted', cell: row => count(row.missing) },
    { head: 'Rate', unit: '1/min', cell: row => row.per_minute == null ? NONE : fixed(row.per_minute, 1) },
    { head: 'To go', cell: row => row.done >= row.chunks ? 'done' : row.to_go_s == null ? NONE : span(row.to_go_s) },
    { head: 'Ends', cell: row => row.done >= row.chunks || row.to_go_s == null ? NONE : moment(Date.now() + 1000 * row.to_go_s) },
    { head: 'Change', cell: changes, left: true }] })
  const node = panel('Workers: bulk work on other machines', { className: 'live', hidden: true }, machines.node, orders.node, said.node, offered,
    failures, gathered, error)

  // A button is made once: rows that are read again must not enable one that is pressed.
  const made = new Map()
  function acting(verb, name, work, { of = name, ...props } = {}) {
    const key = `${verb} ${of}`, what = `${verb} ${name}`
    if (!made.has(key)) made.set(key, actor(verb, said, async () => { await work(); await read() }, { locks: false, what, 'aria-label': what, ...props }))
    return made.get(key)
  }
  const submitting = name => acting('Submit', name, () => send(folderOf(name), {}, { wait: CHANGE_MS }))
  function changes(row) {
    const name = nameOf(row), open = row.waiting + row.running, more = row.failed + row.missing
    return el('div', { className: 'row tight' },
      row.folder && more > 0 && submitting(name),
      row.folder && row.done >= row.chunks && acting('Gather', name, () => send(`${folderOf(name)}/gather`)),
      open > 0 && acting('Cancel', name, () => send(`/workers/orders/${encodeURIComponent(row.order)}`, {}, { method: 'DELETE', wait: CHANGE_MS }), { of: row.order,
        className: 'danger', sure: () => confirm(`Cancel ${name}?`, CANCELLED, 'Cancel the order') }))
  }

  async function ask() {
    const found = await get('/workers', {}, { signal, wait: 40_000 })
    node.hidden = !found.configured
    say(error, '')
    machines.show(found.workers)
    orders.show(found.orders)
    const { gather, unsubmitted } = found
    renew(offered, unsubmitted, () => [unsubmitted.length > 0 && 'Not submitted:', unsubmitted.map(name => [el('span', {}, name), submitting(name)])])
    say(gathered, gather ? `Gathering of ${gather.folder} into ${gather.into}: ${gather.error ?? plain(gather.state)}.` : '')
    gathered.className = TONE[gather?.state] ?? 'soft'
    say(failures, listed(found.orders.flatMap(order => [order.again_error && `A machine could not make ${counted(order.again, 'chunk')}: ${order.again_error}`,
      ...order.errors.map(one => `Chunk ${one.index}, ${counted(one.attempts, 'attempt')}: ${one.error}`)]), '. '))
  }
  async function read() {
    try { await ask() } catch (problem) {
      if (signal.aborted) return
      node.hidden = false
      say(error, `No answer: ${problem.message}`)
    }
  }
  every(PERIOD_MS, read, signal)
  return node
}
