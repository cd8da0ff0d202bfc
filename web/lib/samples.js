// Samples of force and depth of the last minutes, as columns of plain numbers: a night of them leaves no garbage.

const ARMS = 6
/** Minutes of samples that are kept and asked for: the longest time that a chart offers. */
export const KEPT_MINUTES = 15
let room = 4096
const column = Type => new Type(room)

/**
 * The columns, oldest first: `length` entries of each are set. NaN is what was not measured. `at_ms` is of the clock of the
 * service, `arrived_ms`, when the newest of the socket came, of this computer's.
 */
export const samples = { length: 0, arrived_ms: 0, at_ms: column(Float64Array), z_mm: column(Float32Array), forces_n: Array.from({ length: ARMS }, () => column(Float32Array)) }
const columns = () => [samples.at_ms, samples.z_mm, ...samples.forces_n]

/** Index of the first sample at or after a time; `length` if there is none. */
export function indexOf(at) {
  let low = 0, high = samples.length
  while (low < high) {
    const mid = low + high >> 1
    if (samples.at_ms[mid] < at) low = mid + 1
    else high = mid
  }
  return low
}

/** Time of the newest sample, ms; undefined without any. */
export const lastAt = () => samples.length ? samples.at_ms[samples.length - 1] : undefined

/**
 * Replaces the samples after the time `since` by those of an answer: so a gap is filled. Newer ones than the last of
 * the answer, which came meanwhile, are kept. Returns whether the answer had any after `since`.
 */
export function fillSamples(more, since) {
  const last = more?.at_ms?.at(-1) ?? 0
  if (last <= since) return false
  const begin = indexOf(last + 1), late = { at_ms: [], z_mm: [], forces_n: [] }
  for (let i = begin; i < samples.length; i += 1) {
    late.at_ms.push(samples.at_ms[i])
    late.z_mm.push(samples.z_mm[i])
    late.forces_n.push(samples.forces_n.map(column => column[i]))
  }
  samples.length = indexOf(since + 1)
  addSamples(more)
  addSamples(late)
  return true
}

/** Adds the samples of a message that are newer; returns whether there were any. */
export function addSamples(more) {
  const newest = lastAt() ?? 0, from = more?.at_ms?.findIndex(at => at > newest) ?? -1
  if (from < 0) return false
  makeRoom(more.at_ms.length - from)
  for (let i = from; i < more.at_ms.length; i += 1) {
    const to = samples.length
    samples.at_ms[to] = more.at_ms[i]
    samples.z_mm[to] = more.z_mm[i] ?? NaN
    for (let arm = 0; arm < ARMS; arm += 1) samples.forces_n[arm][to] = more.forces_n[i]?.[arm] ?? NaN
    samples.length = to + 1
  }
  return true
}

// Old ones are dropped first; only if all are young the columns grow.
function makeRoom(wanted) {
  if (samples.length + wanted <= room) return
  const old = indexOf(lastAt() - 60_000 * KEPT_MINUTES)
  for (const one of columns()) one.copyWithin(0, old, samples.length)
  samples.length -= old
  if (samples.length + wanted <= 0.75 * room) return
  room = 2 * (room + wanted)
  const grown = from => { const to = column(from.constructor); to.set(from); return to }
  samples.at_ms = grown(samples.at_ms)
  samples.z_mm = grown(samples.z_mm)
  samples.forces_n = samples.forces_n.map(grown)
}
