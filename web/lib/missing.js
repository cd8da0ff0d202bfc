// Which frames of the board are missing in the live answers of the last minute. No DOM.

const KEPT = 60, APART_MS = 3000

/**
 * Makes the count: `add({ sequence, arrived, missed })` once per second takes the frame counter of an answer, how many
 * answers had arrived with it, and how many frames the service had not received; `last()` is { frames, missing,
 * unreceived }, null without two of them. After a pause of the page, and with another board, it begins again.
 */
export function missingOf() {
  let read = []
  return {
    add(one) {
      const now = Date.now(), last = read.at(-1)
      const goesOn = last && now - last.at < APART_MS && one.sequence > last.sequence && one.missed >= last.missed
      if (last && one.sequence === last.sequence) return
      read = [...goesOn ? read.slice(1 - KEPT) : [], { ...one, at: now }]
    },
    clear() { read = [] },
    last() {
      if (read.length < 2) return null
      const over = key => read.at(-1)[key] - read[0][key]
      const missing = Math.max(0, over('sequence') - over('arrived'))
      return { frames: over('sequence'), missing, unreceived: Math.min(missing, over('missed')) }
    },
  }
}
