// The forces of a plan: its limits, and what an earlier run on the same skin pressed at most.

import { get } from './api.js'
import { el, facts, fill, link, panel } from './dom.js'
import { count, counted, fixed } from './format.js'
import { live } from './live.js'
import { table } from './table.js'

const RUNS = 20

/** The newest run before `run` that pressed the same skin, with its forces: { run, settings: [{ tips, configurations, median_n, largest_n }] }, or null. */
async function earlier(run, signal) {
  const { items } = await get('/runs', { limit: RUNS }, { signal })
  const alike = one => one.kind === 'real-hex' && one.started_at && one.uid !== run?.uid && (!run || one.sensor_sha256 === run.sensor_sha256)
  const found = items.find(alike)
  if (!found) return null
  const [tour, progress] = await Promise.all(['tour', 'progress'].map(part => get(`/runs/${found.scan_id}/${part}`, {}, { signal, wait: 20_000 })))
  const settings = progress.forces_by_tips
  return settings.length ? { run: found, deepest_mm: tour.depths_mm.at(-1), settings } : null
}

function seen({ run, deepest_mm, settings }) {
  const words = [
    'Largest force of a configuration in ',
    link(`/runs?run=${run.scan_id}`, `run ${run.scan_id}, ${run.experiment}`),
    `, the newest on this skin, down to ${fixed(deepest_mm, 2, 'mm')}:`,
  ]
  const columns = [
    { head: 'Setting', left: true, cell: one => counted(one.tips, 'tip') },
    { head: 'Configurations', cell: one => count(one.configurations) },
    { head: 'Median', cell: one => fixed(one.median_n, 1, 'N') },
    { head: 'Largest', cell: one => fixed(one.largest_n, 1, 'N') },
  ]
  return [el('p', { className: 'soft' }, words), table({ rows: settings, columns }).node]
}

/** Makes the panel. `p` is the preflight or null, `tour` the tour or null, `run` the stored run or null. */
export function forcesPanel({ p, tour, run, signal }) {
  const rig = live.status?.rig
  const depths = tour?.depths_mm ?? []
  const before = el('div', {}, el('p', { className: 'soft' }, 'Looking for an earlier run on this skin …'))
  const list = facts([
    tour?.force_limit_n != null && ['Limit on one tip', fixed(tour.force_limit_n, 0, 'N')],
    tour?.force_sum_limit_n != null && ['Limit on all tips', fixed(tour.force_sum_limit_n, 0, 'N')],
    ['Limit of the rig', fixed(rig?.force_limit_n, 0, 'N')],
    depths.length > 0 && ['Depths', String(depths.length)],
    depths.length > 0 && ['Deepest', fixed(depths.at(-1), 2, 'mm')],
  ])
  const silent = p?.if_silent ? el('p', { className: 'said' }, `If the service stops during a press: ${p.if_silent}.`) : null
  if (p?.kind !== 'real-random') {
    earlier(run, signal).then(
      found =>
        fill(
          before,
          found
            ? seen(found)
            : el('p', { className: 'soft' }, 'No earlier run pressed this skin: its forces are not known. Beyond a limit the rig trips and raises the tips.'),
        ),
      error => signal.aborted || fill(before, el('p', { className: 'soft' }, `Earlier forces have no answer: ${error.message}.`)),
    )
  } else fill(before, el('p', { className: 'soft' }, 'Weights press with their own force; each is in the experiment file.'))
  return panel('Forces', {}, list, before, silent)
}
