// The simulated twins that the service makes in the background: how far, how fast, how well.

import { get } from './api.js'
import { changing } from './changing.js'
import { el, every, link, panel, say } from './dom.js'
import { about, count, fixed, plain } from './format.js'
import { table } from './table.js'

const PERIOD_MS = 5000
const LEVELS = { ok: 'The model fits the skin.', warn: 'The fit is worse than it should be: look at the pairs.',
  suspend: 'The error of the fit is above the limit that suspends the run: check skin and wires.' }

/** Backlog of the twins, as text. */
export function backlog(twins, run) {
  if (!twins) return null
  const of = twins.runs.find(r => r.run === run) ?? null
  if (!of) return null
  const rate = of.pending > 20 && twins.pool.per_s ? ` at ${fixed(twins.pool.per_s, 0)} per s` : ''
  return `${count(of.pending)} to do${rate}${of.failures ? `, ${count(of.failures)} failed` : ''}`
}

/** Makes the panel of the twins; it asks every five seconds until `signal` aborts. */
export function twins(signal) {
  const numbers = el('div'), verdict = el('p'), error = el('p', { className: 'bad' }), names = new Map()
  const runs = table({ empty: 'No run is stored yet.',
    columns: [{ head: 'Run', cell: row => link(`/runs?run=${row.run}`, names.get(row.run)) }, { head: 'Trials', cell: row => count(row.trials) },
    { head: 'Twins', cell: row => count(row.twins) },
    { head: 'Pending', cell: row => count(row.pending) }, { head: 'Cannot be simulated', cell: row => count(row.failures) }] })
  const node = panel('Twins: every trial simulated again from its measured forces', { className: 'live' }, numbers, verdict, error, runs.node)
  async function ask() {
    const { pool, runs: rows } = await get('/twins', {}, { signal })
    if (rows.some(row => !names.has(row.run))) {
      for (const run of (await get('/runs', { limit: 1000 }, { signal })).items) names.set(run.uid, `${run.scan_id} ${run.experiment}`)
      for (const { run } of rows) if (!names.has(run)) names.set(run, run) // One that is not listed is not asked for again.
    }
    const { rolling } = pool
    changing(numbers, [['Speed', pool.per_s == null ? 'none made yet' : `${about(pool.per_s)}\u202f/s`], ['Made since start', count(pool.made)],
      ['Workers', count(pool.workers)], ['Pending', count(rows.reduce((sum, row) => sum + row.pending, 0))],
      ['Rolling FVU', rolling ? fixed(rolling.median_fvu, 3) : 'no run watched'],
        rolling && ['Pairs over their limit', count(rolling.pairs_over_limit)]])
    const worst = rolling?.worst_pairs.map(pair => `${pair.electrodes.join('–')} (${fixed(pair.fvu, 2)})`).join(', ')
    say(verdict, !rolling ? '' : `${LEVELS[rolling.level] ?? plain(rolling.level)}${worst ? ` Worst pairs of electrodes, by FVU: ${worst}.` : ''}`)
    verdict.className = { ok: 'good', warn: 'warn', suspend: 'bad' }[rolling?.level] ?? 'soft'
    say(error, pool.last_error ? `Last failure: ${pool.last_error}` : '')
    runs.show(rows.slice(0, 20))
  }
  every(PERIOD_MS, async () => {
    try { await ask() } catch (problem) { if (!signal.aborted) say(error, `No answer: ${problem.message}`) }
  }, signal)
  return node
}
