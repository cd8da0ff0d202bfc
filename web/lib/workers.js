// Workers of bulk work on other machines, and their queue: orders, rate, time to go, failed chunks.

import { get } from './api.js'
import { el, panel, say, sleep } from './dom.js'
import { count, fixed, NONE, span } from './format.js'
import { table } from './table.js'

const PERIOD_MS = 10_000

/** Makes the panel of workers; it asks every ten seconds until `signal` aborts, and is hidden without a queue. */
export function workers(signal) {
  const error = el('p', { className: 'bad' }), gathered = el('p', { className: 'soft' }), failures = el('p', { className: 'warn' })
  const machines = table({ empty: 'No worker: palpate worker work', columns: [{ head: 'Worker', cell: row => row.worker },
    { head: 'Heard', cell: row => `${span(row.heard_s)} ago${row.lost ? ', lost' : ''}` }] })
  const orders = table({ empty: 'No order: palpate cluster sbatch, then palpate worker submit',
    columns: [{ head: 'Order', cell: row => row.folder ?? row.order.slice(0, 12) }, { head: 'Chunks', cell: row => count(row.chunks) },
      { head: 'Done', cell: row => count(row.done) }, { head: 'Running', cell: row => count(row.running) },
      { head: 'Waiting', cell: row => count(row.waiting) }, { head: 'Failed', cell: row => count(row.failed) },
      { head: 'Not submitted', cell: row => count(row.missing) },
      { head: 'Rate', unit: '1/min', cell: row => row.per_minute == null ? NONE : fixed(row.per_minute, 1) },
      { head: 'To go', cell: row => row.done >= row.chunks ? 'done' : row.to_go_s == null ? NONE : span(row.to_go_s) }] })
  const node = panel('Workers: bulk simulation on other machines', { className: 'live', hidden: true }, machines.node, orders.node, failures, gathered, error)
  async function ask() {
    const found = await get('/workers', {}, { signal })
    node.hidden = !found.configured
    say(error, '')
    machines.show(found.workers)
    orders.show(found.orders)
    const { gather } = found
    say(gathered, gather ? `Gathering of ${gather.folder}: ${gather.error ?? gather.state}` : '')
    say(failures, found.orders.flatMap(order => [order.again_error && `A machine could not make a chunk: ${order.again_error}`,
      ...order.errors.map(one => `Chunk ${one.index}, ${count(one.attempts)} attempts: ${one.error}`)]).filter(Boolean).join('. '))
  }
  async function follow() {
    for (; !signal.aborted; await sleep(PERIOD_MS, signal)) {
      if (document.hidden) continue
      try { await ask() } catch (problem) {
        if (signal.aborted) continue
        node.hidden = false
        say(error, `No answer: ${problem.message}`)
      }
    }
  }
  follow()
  return node
}
