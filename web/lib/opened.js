// One thing of a list, opened above it: drawn when another one is chosen, ended when it is closed.

import { el, fill } from './dom.js'

/**
 * Makes the place of what is opened. `draw(node, id, signal)` shows the thing `id`; `signal` aborts when
 * another one is shown. `show(id)` opens, or closes without one; after `forget()` the same one is drawn again.
 */
export function opened({ className, signal, draw }) {
  const node = el('div', { className })
  let shown = null
  let ending = new AbortController()
  signal.addEventListener('abort', () => ending.abort())
  return {
    node,
    show(id) {
      if (id === shown) return
      shown = id
      ending.abort()
      ending = new AbortController()
      node.hidden = !id
      fill(node)
      if (id) draw(node, id, ending.signal)
    },
    forget() {
      shown = undefined
    },
  }
}
