// The address as the state of a page: a reload or a copied link shows the same. All writing of it is here.
// Never a key or another secret: an address is copied, logged, and kept in the history of the browser.

// A browser refuses an address that is written too often: small changes in quick succession are one.
const REST_MS = 250

/** Dispatches `open` when the page must follow another address. */
export const address = new EventTarget()

let waiting = {}
let timer = 0

function drop() {
  clearTimeout(timer)
  timer = 0
  waiting = {}
}

/** The present address with some parameters changed; null removes one. */
function withState(changes) {
  const query = new URLSearchParams(location.search)
  for (const [key, value] of Object.entries(changes)) value == null || value === '' ? query.delete(key) : query.set(key, value)
  return `${location.pathname}${query.size ? `?${query}` : ''}`
}

function write() {
  const href = withState(waiting)
  drop()
  if (href !== location.pathname + location.search) history.replaceState(history.state, '', href + location.hash)
}

/** The parameters of the address, with those that are about to be written. */
export function params() {
  const all = Object.fromEntries(new URLSearchParams(location.search))
  for (const [key, value] of Object.entries(waiting)) value == null || value === '' ? delete all[key] : (all[key] = String(value))
  return all
}

/** Goes to an address of the dashboard; `replace` keeps the history as it is. */
export function go(href, { replace = false } = {}) {
  if (timer) write()
  history[replace ? 'replaceState' : 'pushState'](null, '', href)
  address.dispatchEvent(new Event('open'))
}

/** Changes parameters of the present address; the page follows it. */
export const set = (changes, options) => {
  const all = { ...waiting, ...changes }
  drop()
  go(withState(all), { replace: true, ...options })
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
  address.dispatchEvent(new Event('open'))
})
