// Counters as rates: what a wire or the stream did in the last minute, not since it was opened.

const WINDOW_MS = 60_000, STEP_MS = 1000, SURE_S = 8

/**
 * Keeps snapshots of counters for a minute. `add(counters)` takes { name: { key: count } }; `of(name)`
 * returns { seconds, change: { key: difference } }, or null before two snapshots, and for some seconds while
 * nothing changed: the service itself reads the counters only every few seconds.
 */
export function rates() {
  let kept = []
  return {
    add(counters, at = Date.now()) {
      if (kept.length && at - kept.at(-1).at < STEP_MS) return
      // A counter that fell was opened again: what was before does not count.
      const fell = Object.entries(counters).some(([name, now]) => Object.entries(now).some(([key, n]) => n < (kept.at(-1)?.counters[name]?.[key] ?? 0)))
      if (fell) kept = []
      kept.push({ at, counters })
      while (kept.length > 2 && kept[1].at <= at - WINDOW_MS) kept.shift()
    },
    of(name) {
      const first = kept[0]?.counters[name], last = kept.at(-1)?.counters[name]
      if (!first || !last || kept.length < 2) return null
      const seconds = (kept.at(-1).at - kept[0].at) / 1e3, change = Object.fromEntries(Object.entries(last).map(([key, n]) => [key, n - (first[key] ?? 0)]))
      return seconds < SURE_S && Object.values(change).every(n => n === 0) ? null : { seconds, change }
    },
  }
}

/** Events per minute of a change; null if the window is too short to say. */
export const perMinute = (rate, key) => !rate || rate.seconds < 2 ? null : rate.change[key] / rate.seconds * 60
