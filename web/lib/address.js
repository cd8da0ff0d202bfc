// The address as the state of a page: a reload or a copied link shows the same. All writing of it is here.
// Never a key or another secret: an address is copied, logged, and kept in the history of the browser.

// A browser refuses an address that is written too often: small changes in quick succession are one. It allows 100
// to 200 within 10 s to 30 s.
const REST_MS = 250
const AGAIN_MS = 1000

/** Dispatches `open` when the page must follow another address. */
export const address = new EventTarget()

let waiting = {}
let ahead = null // { href, isNew }: the page shows this address; the browser gets it later. `isNew`: as a new entry.
let timer = 0
let written = -Infinity

/** The address that the page shows, as a URL; the browser may get it later. */
export const shown = () => new URL(ahead?.href ?? location.href)

/** Forgets the changes that wait. An address that is ahead stays; without its timer, `record` must follow. */
function drop() {
  clearTimeout(timer)
  timer = 0
  waiting = {}
}

/** The present address with some parameters changed; null removes one. */
function withState(changes) {
  const { pathname, searchParams: query } = shown()
  for (const [key, value] of Object.entries(changes)) value == null || value === '' ? query.delete(key) : query.set(key, value)
  return `${pathname}${query.size ? `?${query}` : ''}`
}

/** Gives an address to the browser: now, or after `rest` ms. One that the browser refuses is tried again. */
function record(to, isPush, rest = 0) {
  const { href } = new URL(to, location.href)
  const isNew = isPush || Boolean(ahead?.isNew)
  ahead = null
  if (href === location.href) return
  if (!rest) {
    written = performance.now()
    try {
      history[isNew ? 'pushState' : 'replaceState'](null, '', href)
    } catch { /* Too many: Firefox and Safari throw, Chromium changes nothing. */ }
    if (href === location.href) return
  }
  ahead = { href, isNew }
  timer ||= setTimeout(write, rest || AGAIN_MS)
}

function write() {
  const href = withState(waiting) + shown().hash
  drop()
  record(href, false)
}

/** The parameters of the address, with those that are about to be written. */
export function params() {
  const all = Object.fromEntries(shown().searchParams)
  for (const [key, value] of Object.entries(waiting)) value == null || value === '' ? delete all[key] : (all[key] = String(value))
  return all
}

/** Goes to an address of the dashboard; `replace` keeps the history as it is. */
export function go(href, { replace = false } = {}) {
  if (timer) write()
  // A key that is held down replaces the address 30 times per second.
  record(href, !replace, replace ? Math.max(0, written + REST_MS - performance.now()) : 0)
  address.dispatchEvent(new Event('open'))
}

/** Changes parameters of the present address; the page follows it. */
export const set = (changes, options) => {
  const href = withState({ ...waiting, ...changes })
  drop()
  go(href, { replace: true, ...options })
}

/** Changes parameters of what the page shows already: the address is rewritten soon, and no page is told. */
export function put(changes) {
  Object.assign(waiting, changes)
  timer ||= setTimeout(write, REST_MS)
}

/**
 * Keeps one part of what is shown in the parameter `name`. `take(text)` shows what the address has, now and whenever it
 * changes; `text()` is what is shown, null for the usual. A link within the page that lacks the parameter undoes nothing.
 * Returns the function to call after a person has changed the part. Ends with `signal`.
 */
export function hold(name, { take, text, signal }) {
  const follow = () => {
    const wanted = params()[name]
    if (wanted == null) text() != null && put({ [name]: text() })
    else if (wanted !== text()) take(wanted)
  }
  address.addEventListener('open', follow, { signal })
  follow()
  return () => {
    if (!signal?.aborted) put({ [name]: text() }) // The address is that of another page by then.
  }
}

addEventListener('popstate', () => {
  drop() // What waited belongs to the address that was left.
  ahead = null
  address.dispatchEvent(new Event('open'))
})
