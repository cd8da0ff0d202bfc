// A list of the API that is read page by page, and its first page again and again: what was read beyond it stays.

import { get } from './api.js'

/**
 * Makes the list at `path`: `items` in the order of the API, `next` while there are more. `read()` reads the first page,
 * `read(true)` the one after what is known; both return the body. `key(item)` tells items apart; `query` selects them.
 */
export function listing(path, { query = {}, limit, signal, key = item => item.id }) {
  let items = []
  let next = null
  let isFurther = false
  return {
    get items() {
      return items
    },
    get next() {
      return next
    },
    async read(further = false) {
      const page = await get(path, { ...query, limit, cursor: further ? next : null }, { signal })
      const fresh = new Set(page.items.map(key))
      const others = items.filter(item => !fresh.has(key(item)))
      isFurther ||= further
      if (!isFurther) items = page.items
      else items = further ? [...others, ...page.items] : [...page.items, ...others]
      if (further || !isFurther) next = page.next ?? null
      return page
    },
  }
}
