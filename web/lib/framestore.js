// Recorded frames in this browser, bounded: in IndexedDB, which outlives a reload and the tab, or in memory where the
// browser forbids it. A part is some frames in a row: { label, channels, at, sequence, device_time_us, voltages_v }. No DOM,
// except the question of the browser before it closes a page whose frames are in memory alone.

const NAME = 'palpate-frames'

/** Most frames that are kept: five minutes at 30 per second, 28 MB of 784 channels as 32-bit numbers. */
export const MOST = 9000

/** What is kept of nothing. `saved`: whether a file of all of it was made; times in ms. */
export const NOTHING = { frames: 0, bytes: 0, missed: 0, channels: 0, labels: [], from: null, to: null, saved: true }

/** What is kept once a part is added. */
function sum(kept, part) {
  return {
    frames: kept.frames + part.at.length,
    bytes: kept.bytes + part.voltages_v.byteLength,
    missed: kept.missed + part.missed,
    channels: Math.max(kept.channels, part.channels),
    labels: [...new Set([...kept.labels, part.label])],
    from: kept.from ?? part.at[0],
    to: part.at.at(-1),
    saved: false,
  }
}

/** The begin of a part, where the rest has no room. */
function first(part, frames) {
  if (part.at.length <= frames) return part
  const cut = { ...part, voltages_v: part.voltages_v.slice(0, frames * part.channels) }
  for (const key of ['at', 'sequence', 'device_time_us']) cut[key] = part[key].slice(0, frames)
  return cut
}

/** Marks what is kept as saved, unless it has changed since `of`, what the file was made of. */
const savedAs = (now, of) => (now.frames === of.frames && now.to === of.to ? { ...now, saved: true } : now)

const answer = request =>
  new Promise((resolve, reject) => {
    request.onsuccess = () => resolve(request.result)
    request.onerror = () => reject(request.error)
  })
const done = work =>
  new Promise((resolve, reject) => {
    work.oncomplete = () => resolve()
    work.onabort = () => reject(work.error ?? new Error('the browser stored nothing'))
  })

function lasting(base) {
  const open = mode => {
    const work = base.transaction(['parts', 'kept'], mode)
    return { work, parts: work.objectStore('parts'), kept: work.objectStore('kept') }
  }
  const read = async kept => (await answer(kept.get(0))) ?? NOTHING
  return {
    isLasting: true,
    kept: () => read(open('readonly').kept),
    /** Adds a part, as far as there is room, and returns what is kept. Two tabs that record share the room. */
    async add(part) {
      const { work, parts, kept } = open('readwrite')
      const over = done(work)
      over.catch(() => {}) // Told by `await over`; a failure before that is the same one.
      const now = await read(kept)
      const fit = first(part, MOST - now.frames)
      const next = fit.at.length ? sum(now, fit) : now
      if (fit.at.length) {
        parts.add(fit)
        kept.put(next, 0)
      }
      await over
      return next
    },
    /** Calls `then` with each part, one after the other, oldest first. */
    async each(then) {
      for (const key of await answer(open('readonly').parts.getAllKeys())) {
        const part = await answer(open('readonly').parts.get(key))
        if (part) then(part) // Another tab may have discarded it meanwhile.
      }
    },
    async markSaved(of) {
      const { work, kept } = open('readwrite')
      const now = await read(kept)
      if (now.frames) kept.put(savedAs(now, of), 0)
      await done(work)
    },
    async clear() {
      const { work, parts, kept } = open('readwrite')
      parts.clear()
      kept.clear()
      await done(work)
    },
  }
}

function passing() {
  let all = []
  let now = NOTHING
  // On every page, until the tab is closed: the page that recorded may have been left.
  addEventListener('beforeunload', event => {
    if (!now.saved) event.preventDefault()
  })
  return {
    isLasting: false,
    kept: async () => now,
    async add(part) {
      const fit = first(part, MOST - now.frames)
      if (fit.at.length) {
        all.push(fit)
        now = sum(now, fit)
      }
      return now
    },
    async each(then) {
      for (const part of all) then(part)
    },
    async markSaved(of) {
      now = savedAs(now, of)
    },
    async clear() {
      all = []
      now = NOTHING
    },
  }
}

let opened = null

/** The store of this browser; opened once. */
export function frameStore() {
  opened ??= new Promise((resolve, reject) => {
    const request = indexedDB.open(NAME, 1)
    request.onupgradeneeded = () => {
      request.result.createObjectStore('parts', { autoIncrement: true })
      request.result.createObjectStore('kept')
    }
    request.onsuccess = () => resolve(request.result)
    request.onerror = () => reject(request.error)
  }).then(lasting, passing)
  return opened
}
