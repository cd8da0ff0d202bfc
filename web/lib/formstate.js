// Values of a form in the address, by the ids of its controls. What is usual is not written.
// Never for a key or a name of a person; what commits a person to something is chosen again each time.

import { hold } from './address.js'
import { choose } from './dom.js'

const SECRET = ['password', 'file']
// An empty value that is not the usual one, as "all rows" where a part is usual.
const NOTHING = '-'
const valueOf = node => (node.type === 'checkbox' ? (node.checked ? 'yes' : '') : node.value)

/** Gives a control a value; a select whose choices are not read yet gets it as a choice. */
function give(node, value) {
  if (node.type === 'checkbox') node.checked = value === 'yes'
  else if (node.tagName === 'SELECT') choose(node, value)
  else node.value = value
  node.dataset.chosen = valueOf(node)
}

/**
 * Keeps the values of controls in the address. `usual(node)` is the value that is not written: if it is undefined, the
 * present one, if false, none. `changed(node)` follows a value that came from the address. Returns `write(node)`, for values
 * that the form itself sets.
 */
export function keepForm(controls, { usual = () => undefined, changed = () => {}, signal }) {
  const first = new Map(controls.map(node => [node, valueOf(node)]))
  const isUsual = node => valueOf(node) === (usual(node) ?? first.get(node))
  const writes = new Map()
  for (const node of controls) {
    if (!node.id || SECRET.includes(node.type)) throw new Error(`${node.id || node.tagName}: this control is not kept in an address`)
    const text = () => (isUsual(node) ? null : valueOf(node) || NOTHING)
    const take = value => {
      give(node, value === NOTHING ? '' : value)
      changed(node)
    }
    writes.set(node, hold(node.id, { take, text, signal }))
    node.addEventListener('change', () => {
      node.dataset.chosen = valueOf(node)
      writes.get(node)()
    })
  }
  return node => writes.get(node)?.()
}
