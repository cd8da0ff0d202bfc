// What a trial is shown with: its configuration's other depths, and a frame without contact.

import { Refused, get } from './api.js'
import { counted, fixed, moment } from './format.js'

/** Below this force a tip is not felt to touch, N. */
const FREE_N = 1

/**
 * Finds what a trial is shown with: all depths of its configuration, the deepest one's frames (for
 * the scale), and the untouched frame. `read(id)` gives a whole trial.
 */
export async function around(row, read, { signal } = {}) {
  const alone = row.kind === 'imported' || row.kind === 'real-random'
  const query = { scan_id: row.scan_id, configuration: row.configuration, limit: 60 }
  const siblings = alone ? [row] : (await get('/trials', query, { signal })).items
  const by = [...siblings].sort((a, b) => a.depth_mm - b.depth_mm)
  const other = one => (one && one.trial_id !== row.trial_id ? read(one.trial_id).catch(() => null) : null)
  return { siblings, deepest: await other(by.at(-1)), untouched: await untouched(row, by[0], other, signal) }
}

/**
 * The untouched frame that is closest to a trial: the start of its configuration if no tip touched
 * there, else the rig's of the same run, else what there is; its words say which.
 */
async function untouched(row, first, other, signal) {
  const start = first?.contact_count === 0 ? await other(first) : null
  const own = start && {
    voltages_v: start.voltages_v,
    words: `Untouched: trial ${start.trial_id} of this configuration, depth ${fixed(start.depth_mm, 1, 'mm')}, ${fixed(start.max_force_n, 1, 'N')} at most.`,
  }
  if (own && (start.max_force_n ?? 0) < FREE_N) return own
  const still = await get('/frames/untouched', {}, { signal }).catch(error => {
    if (error instanceof Refused) return null
    throw error
  })
  if (still?.voltages_v.length !== row.voltages_v.length) return own
  const mine = String(still.run) === String(row.scan_id) || still.run === row.run
  if (own && !mine) return own
  const whose = mine ? 'of this run' : still.run == null ? 'before a run' : `of run ${still.run}, another one`
  return { voltages_v: still.voltages_v, words: `Untouched: mean of ${counted(still.frames, 'frame')} ${whose}, ${moment(still.at)}.` }
}
