// The small menu of every picture: its numbers (CSV), the picture (PNG), the request behind it.

import { button, download, el } from './dom.js'
import { listed } from './format.js'
import { shows } from './save.js'
import { csv } from './table.js'

const slug = text => text.toLowerCase().replace(/[^a-z0-9]+/g, '-')

/**
 * Makes a figure: heading, picture, menu. `data()` returns { heads, rows } for the CSV; `canvas()`
 * the canvas for the PNG; `query` the address of the numbers in the API.
 */
export function picture({ title, name, label, data, canvas, query, props = {} }, ...inside) {
  // The numbers have no place for the label: the name of the file has it.
  const file = () => listed([name ?? slug(title), slug(label?.() ?? '')], '-')
  const items = [
    data && button('Numbers (CSV)', () => { const { heads, rows } = data(); download(`${file()}.csv`, csv(heads, rows), 'text/csv') }),
    canvas && button('Picture (PNG)', () => labelled(canvas(), listed([title, label?.()], ' · ')).toBlob(blob => download(`${file()}.png`, blob))),
    query && shows('Request behind it', query, () => `${file()}.${/format=csv/.test(typeof query === 'function' ? query() : query) ? 'csv' : 'json'}`),
  ].filter(Boolean)
  const menu = items.length ? el('details', { className: 'menu', name: 'picture-menu' }, el('summary', { 'aria-label': `${title}: save` }, '⋯'), el('div', {}, items)) : null
  return el('figure', { className: 'picture', ...props }, el('figcaption', {}, el('span', {}, title), menu), ...inside)
}

// One menu is open at a time; it is over with a press elsewhere, with Escape, and once a button of it was pressed.
document.addEventListener('click', ({ target }) => {
  const menu = document.querySelector('.menu[open]')
  if (menu && (!menu.contains(target) || target.closest('button'))) menu.open = false
})
document.addEventListener('keydown', ({ key, target }) => {
  const menu = key === 'Escape' && target.closest?.('.menu[open]')
  if (!menu) return
  menu.open = false
  menu.querySelector('summary').focus()
})

/** The picture with its title and label written above it: a figure says by itself what was virtual. */
function labelled(from, words) {
  const scale = window.devicePixelRatio || 1, top = Math.round(26 * scale)
  const to = el('canvas', { width: from.width, height: from.height + top }), pen = to.getContext('2d')
  const style = getComputedStyle(document.body)
  pen.fillStyle = style.getPropertyValue('--panel') || '#fff'
  pen.fillRect(0, 0, to.width, to.height)
  pen.fillStyle = style.color
  pen.font = `${Math.round(14 * scale)}px system-ui, sans-serif`
  pen.fillText(words, 8 * scale, 18 * scale)
  pen.drawImage(from, 0, top)
  return to
}
