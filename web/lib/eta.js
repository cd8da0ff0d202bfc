// The predicted end of a run as the bar and the night show it: steady enough to be read. No DOM.

const RENEW_MS = 1000, NEAR_MS = 15_000, NEAR_SHARE = 0.1

let shown = { run: '', at: 0, ends: [] }

/**
 * Likely, early and late end of a run, ms, by its status of the time `at`. They are renewed once per second and move by
 * at most the time since then, as a clock does. An estimate that differs by more than 15 s and by more than a tenth of the
 * remaining time is shown at once.
 */
export function steadyEnds({ uid, eta }, at) {
  const known = shown.run === uid, since = at - shown.at
  if (known && since < RENEW_MS) return shown.ends
  const ends = [eta.remaining_s, eta.low_s, eta.high_s].map((s, i) => {
    const end = at + 1e3 * s, by = end - shown.ends[i]
    if (!known || Math.abs(by) > Math.max(NEAR_MS, NEAR_SHARE * 1e3 * s)) return end
    return shown.ends[i] + Math.max(-since, Math.min(since, by))
  })
  shown = { run: uid, at, ends }
  return ends
}
