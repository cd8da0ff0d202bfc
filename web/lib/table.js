// Tables: heads with units, empty words, rows that lead somewhere.

import { el, fill } from './dom.js'
import { NONE } from './format.js'

/**
 * Makes a table. A column is { head, unit?, cell(row) -> text or node, left? }. `href(row)` makes a
 * row's first cell a link. `empty` says what to do when there is nothing: a text, or what returns one.
 */
export function table({ columns, rows = [], caption, empty = 'Nothing yet.', href, current }) {
  const node = el('div', { className: 'table' })
  // What scrolls is reached by the keyboard, what does not is no stop.
  new ResizeObserver(() => node.scrollWidth > node.clientWidth || node.scrollHeight > node.clientHeight ? node.tabIndex = 0 : node.removeAttribute('tabindex')).observe(node)
  const head = column => el('th', { scope: 'col', className: column.left ? 'left' : '' }, column.head, column.unit ? el('span', { className: 'unit' }, ` ${column.unit}`) : '')
  const cell = (row, column, i) => {
    const value = column.cell(row) ?? NONE
    const inside = i === 0 && href?.(row) ? el('a', { href: href(row) }, value) : value
    return el(i === 0 ? 'th' : 'td', { ...(i === 0 && { scope: 'row' }), className: column.left ? 'left' : '', data: { head: column.head } }, inside)
  }
  const show = rows => {
    const focused = node.contains(document.activeElement) && keyOf(document.activeElement)
    draw(rows)
    // Rows that are read again and again must not take the focus from what a person is at, nor give it to another row's.
    const alike = focused && !node.contains(document.activeElement) ? [...node.querySelectorAll('a, button')].filter(one => keyOf(one) === focused) : []
    if (alike.length === 1) alike[0].focus({ preventScroll: true })
    return node
  }
  const keyOf = one => [one.getAttribute('href'), one.ariaLabel ?? one.textContent].join(' ')
  const draw = rows => {
    if (!rows.length) return fill(node, el('p', { className: 'soft' }, typeof empty === 'function' ? empty() : empty))
    const line = row => el('tr', { className: current?.(row) ? 'current' : '' }, columns.map((column, i) => cell(row, column, i)))
    return fill(node, el('table', {}, caption && el('caption', {}, caption), el('thead', {}, el('tr', {}, columns.map(head))), el('tbody', {}, rows.map(line))))
  }
  show(rows)
  return { node, show }
}

/** Rows as CSV: heads, then one line per row. */
export function csv(heads, rows) {
  const quoted = value => {
    const text = value == null ? '' : String(value)
    return /[",\n]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text
  }
  return [heads, ...rows].map(row => row.map(quoted).join(',')).join('\n') + '\n'
}
