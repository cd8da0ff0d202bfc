// A list of the API that is read page by page, and its first page again and again: what was read beyond it stays.

import { get } from './api.js'
import { button, el, note, replacing } from './dom.js'

/**
 * Makes the list at `path`: `items` in the order of the API, at most `most`, and `next` while there are more. `read()` reads
 * the first page, `read(true)` the one after what is known, as the button `more` does; then `draw(body)` is called, with
 * null if it failed, which `trouble` states: `words` names the list there. `key(item)` tells items apart. `select(query)`
 * begins again with another selection: no answer for an earlier one is drawn.
 */
export function listing(path, { words, draw, limit, most = 1000, signal, key = item => item.id }) {
  let query = {}
  const selecting = replacing(signal)
  let selected = selecting()
  let items = []
  let next = null
  let isFurther = false
  const trouble = el('p', { className: 'bad', role: 'status', hidden: true })
  const more = button('More', () => read(true), { hidden: true })

  let asked = 0
  let newest = 0
  async function read(further = false) {
    const mine = (asked += 1)
    const until = selected
    more.disabled = further
    const page = await get(path, { ...query, limit, cursor: further ? next : null }, { signal: until }).catch(error => ({ error }))
    if (until.aborted) return undefined
    more.disabled = false
    if (!further && mine < newest) return undefined // What was asked later has come before it.
    newest = Math.max(newest, mine)
    note(trouble, page.error ? `${words} could not be read: ${page.error.message}.` : '')
    if (page.error && further) trouble.scrollIntoView({ block: 'nearest' }) // The button is below the rows.
    if (page.error) return draw(null)
    take(page, further)
    return draw(page)
  }
  function select(wanted) {
    selected = selecting()
    query = wanted
    items = []
    next = null
    isFurther = false
    more.hidden = true
    note(trouble, '')
    return read()
  }
  function take(page, further) {
    const fresh = new Set(page.items.map(key))
    const others = items.filter(item => !fresh.has(key(item)))
    isFurther ||= further
    if (!isFurther) items = page.items
    else items = further ? [...others, ...page.items] : [...page.items, ...others]
    if (further || !isFurther) next = page.next ?? null
    more.hidden = !next || items.length >= most
  }
  return {
    more,
    trouble,
    read,
    select,
    get items() {
      return items
    },
    get next() {
      return next
    },
  }
}
