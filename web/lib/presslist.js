// Contacts that a person presses into a drawn skin: their text in an address, and the list in which they are edited.

import { button, el, fill, select } from './dom.js'
import { fixed } from './format.js'
import { vocabulary } from './vocabulary.js'

/** Most contacts of a simulation. */
export const most = () => vocabulary.simulation.contacts_max

const LOAD = { force_n: { sign: 'n', step: 0.5, words: 'force, N' }, depth_mm: { sign: 'mm', step: 0.1, words: 'depth, mm' } }
/** Largest load of a kind; without a `shape` a depth has none. */
const mostOf = (kind, shape) => kind === 'force_n' ? vocabulary.simulation.force_max_n : shape?.foam_thickness_mm
const TEXT = /^(-?[\d.]+),(-?[\d.]+),([\d.]+)(n|mm)$/

/** "270,280,20n;100,150,1.5mm" as contacts; other text is omitted. "none" is no contact. */
export function parseContacts(text) {
  return (text ?? '').split(';').slice(0, most()).flatMap(one => {
    const [, x, y, value, sign] = TEXT.exec(one) ?? []
    const numbers = [x, y, value].map(Number)
    if (!sign || numbers.some(Number.isNaN)) return []
    return [{ x_mm: numbers[0], y_mm: numbers[1], kind: sign === 'n' ? 'force_n' : 'depth_mm', value: numbers[2] }]
  })
}

const HEADS = ['x, mm', 'y, mm', 'Given by', 'Value']

/** Contacts as the text of an address. */
export const contactsText = contacts => contacts.length
  ? contacts.map(c => `${+c.x_mm.toFixed(1)},${+c.y_mm.toFixed(1)},${+c.value.toFixed(3)}${LOAD[c.kind].sign}`).join(';') : 'none'

/** Contacts as the body of a request. */
export const asked = contacts => contacts.map(({ x_mm, y_mm, kind, value }) => ({ x_mm, y_mm, [kind]: value }))

/** A contact, moved so that its whole tip is on the skin, and its load within the limits. */
export function within(contact, shape) {
  const bound = (v, low, high) => Math.min(high ?? Infinity, Math.max(low, v))
  const rim = (shape?.tip_diameter_mm ?? 0) / 2
  const place = shape && { x_mm: bound(contact.x_mm, rim, shape.width_mm - rim), y_mm: bound(contact.y_mm, rim, shape.height_mm - rim) }
  return { ...contact, ...place, value: bound(contact.value, 0, mostOf(contact.kind, shape)) }
}

/**
 * Makes the list of contacts with inputs. `change(i, contact | null)` is called with what a person entered;
 * `show(contacts, answer)` draws them, with the load that the model found; `focus(i)` goes to the load of one.
 */
export function contactList(change) {
  const node = el('div', { className: 'table' })
  let rows = []
  const field = (i, key, name, step) => el('input', {
    type: 'number', step, 'aria-label': `Contact ${i + 1}: ${name}`,
    onchange: event => { const value = event.target.valueAsNumber; if (Number.isFinite(value)) change(i, { [key]: value }) },
  })
  function row(i) {
    const x = field(i, 'x_mm', 'x, mm', 1), y = field(i, 'y_mm', 'y, mm', 1), value = field(i, 'value', 'load', 'any'),
      found = el('td', { className: 'nowrap' })
    const kinds = Object.entries(LOAD).map(([key, { words }]) => [key, words])
    const kind = select(kinds, 'force_n', next => change(i, { kind: next }), { 'aria-label': `Contact ${i + 1}: given by` })
    const remove = button('Remove', () => {
      change(i, null)
      rows[Math.min(i, rows.length - 1)]?.remove.focus() // The rows are new: the focus stays in the list.
    }, { className: 'plain', 'aria-label': `Remove contact ${i + 1}` })
    const line = el('tr', {}, el('th', { scope: 'row' }, String(i + 1)), [x, y, kind, value].map((input, k) => el('td', { data: { head: HEADS[k] } }, input)), found, el('td', {}, remove))
    return { x, y, value, kind, found, remove, line }
  }
  function make(count) {
    rows = Array.from({ length: count }, (_, i) => row(i))
    const heads = ['', ...HEADS, 'Model', ''].map(head => head ? el('th', { scope: 'col' }, head) : el('td'))
    fill(node, count ? el('table', { className: 'press-list' }, el('thead', {}, el('tr', {}, heads)), el('tbody', {}, rows.map(({ line }) => line)))
      : el('p', { className: 'soft' }, 'No contact: the skin is untouched. Click on the skin to press it.'))
  }
  const write = (input, value) => { if (document.activeElement !== input || input.valueAsNumber !== value) input.value = value }
  function show(contacts, answer, shape) {
    if (contacts.length !== rows.length || !node.firstChild) make(contacts.length)
    contacts.forEach((contact, i) => {
      const { x, y, kind, value, found } = rows[i], { step } = LOAD[contact.kind], other = answer?.[i]
      write(x, +contact.x_mm.toFixed(1))
      write(y, +contact.y_mm.toFixed(1))
      Object.assign(value, { min: 0, max: mostOf(contact.kind, shape) ?? '', step })
      write(value, +contact.value.toFixed(3))
      kind.value = contact.kind
      found.textContent = !other ? '' : contact.kind === 'force_n' ? fixed(other.depth_mm, 2, 'mm') : fixed(other.force_n, 1, 'N')
    })
  }
  const focus = i => rows[i]?.value.focus({ preventScroll: true })
  return { node, show, focus }
}
