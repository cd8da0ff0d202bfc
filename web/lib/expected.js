// The forces of a plan: its limits, and what an earlier run on the same skin pressed at most.

import { el, facts, link, panel } from './dom.js'
import { count, counted, fixed } from './format.js'
import { live } from './live.js'
import { table } from './table.js'

function seen({ scan_id, experiment, deepest_mm, forces_by_tips }) {
  const words = [
    'Largest force of a configuration in ',
    link(`/runs?run=${scan_id}`, `run ${scan_id}, ${experiment}`),
    `, the newest before it on this skin, down to ${fixed(deepest_mm, 2, 'mm')}:`,
  ]
  const columns = [
    { head: 'Setting', left: true, cell: one => counted(one.tips, 'tip') },
    { head: 'Configurations', cell: one => count(one.configurations) },
    { head: 'Median', cell: one => fixed(one.median_n, 1, 'N') },
    { head: 'Largest', cell: one => fixed(one.largest_n, 1, 'N') },
  ]
  return [el('p', { className: 'soft' }, words), table({ rows: forces_by_tips, columns }).node]
}

/** What is known of the forces before the run: those of an earlier one, as the preflight states it. */
function before(p) {
  if (!p) return ''
  if (p.kind === 'real-random') return el('p', { className: 'soft' }, 'Weights press with their own force; each is in the experiment file.')
  if (p.earlier) return seen(p.earlier)
  return el('p', { className: 'soft' }, 'No earlier run pressed this skin: its forces are not known. Beyond a limit the rig trips and raises the tips.')
}

/** Makes the panel. `p` is the preflight or null, `tour` the tour or null. */
export function forcesPanel({ p, tour }) {
  const depths = tour?.depths_mm ?? []
  const list = facts([
    tour?.force_limit_n != null && ['Limit on one tip', fixed(tour.force_limit_n, 0, 'N')],
    tour?.force_sum_limit_n != null && ['Limit on all tips', fixed(tour.force_sum_limit_n, 0, 'N')],
    ['Limit of the rig', fixed(live.status?.rig.force_limit_n, 0, 'N')],
    depths.length > 0 && ['Depths', String(depths.length)],
    depths.length > 0 && ['Deepest', fixed(depths.at(-1), 2, 'mm')],
  ])
  const silent = p?.if_silent ? el('p', { className: 'said' }, `If the service stops during a press: ${p.if_silent}.`) : null
  return panel('Forces', {}, list, before(p), silent)
}
