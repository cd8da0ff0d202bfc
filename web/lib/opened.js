// One thing of a list, opened above it: drawn when another one is chosen, ended when it is closed.

import { el, fill, link, replacing } from './dom.js'

/** The line above an opened thing: its name, its id, and the link that closes it. */
export const openedHead = (name, id, href) =>
  el('div', { className: 'row spread' }, el('h2', { className: 'big' }, el('span', {}, name, ' ', el('span', { className: 'soft small' }, id))), link(href, 'Close'))

/**
 * Makes the place of what is opened. `draw(node, id, signal)` shows the thing `id`; `signal` aborts when
 * another one is shown. If it fails, its error is shown, with the link `back` ([address, words]).
 * `show(id)` opens, or closes without one; after `forget()` the same one is drawn again.
 */
export function opened({ className, signal, draw, back }) {
  const node = el('div', { className })
  const opening = replacing(signal)
  let shown = null
  async function open(id, mine) {
    try { await draw(node, id, mine) } catch (error) {
      if (!mine.aborted) fill(node, el('section', {}, el('h2', { className: 'big' }, id), el('p', { className: 'bad' }, error.message), link(...back)))
    }
  }
  return {
    node,
    show(id) {
      if (id === shown) return
      shown = id
      const mine = opening()
      node.hidden = !id
      fill(node)
      if (id) open(id, mine)
    },
    forget() {
      shown = undefined
    },
  }
}
