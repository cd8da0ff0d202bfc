// A part that is folded away until it is opened; whether it is open is in the address.

import { hold } from './address.js'
import { el } from './dom.js'

/** Makes a `details` with its summary; `name` is unique in its page. Ends with `signal`. */
export function fold(name, words, { signal }, ...inside) {
  const node = el('details', {}, el('summary', {}, words), ...inside)
  const write = hold(`open-${name}`, {
    take: text => { node.open = text === 'yes' },
    text: () => (node.open ? 'yes' : null),
    signal,
  })
  node.addEventListener('toggle', write, { signal })
  return node
}
