// The force map under a hand: contacts with number, force and ellipse of uncertainty, on the skin, at the
// rate of the frames. Nothing is allocated for a frame except what the contacts need.

import { colour, dark, el, fill } from './dom.js'
import { fixed } from './format.js'
import { sequential, strip } from './frame.js'
import { disc, lettering } from './pen.js'
import { nearest, skin } from './skin.js'

const SAME_MM = 40, SDS = 2

/** Gives each contact the number that it had in the frame before: the nearest within 40 mm keeps it. */
export function numbered(contacts, before) {
  const free = [...before], used = new Set()
  for (const contact of contacts) {
    const best = nearest(free.map(old => [old.x_mm, old.y_mm]), [contact.x_mm, contact.y_mm], SAME_MM)
    contact.number = best < 0 ? 0 : free.splice(best, 1)[0].number
    if (contact.number) used.add(contact.number)
  }
  let next = 1
  for (const contact of contacts) {
    if (contact.number) continue
    while (used.has(next)) next += 1
    contact.number = next
    used.add(next)
  }
  return contacts
}

/** Makes the map. `show(answer)` draws a message of the live socket; `scale(n)` sets the force at the end of the colours, N. */
export function touchMap({ signal, label, query }) {
  let answer = null, end = 50, palette = sequential(), ink = inks()
  let image = null, board = null, side = 0
  const legend = el('p', { className: 'legend' })
  const view = skin({ title: 'Force map', signal, label, query, tall: true, draw, describe,
    data: () => ({ heads: ['number', 'x_mm', 'y_mm', 'force_n'], rows: (answer?.contacts ?? []).map(c => [c.number, c.x_mm, c.y_mm, c.force_n]) }) })

  function inks() { return { text: colour('--ink'), ground: colour('--panel'), line: colour('--ink'), unsure: colour('--warn') } }
  const shade = force => palette[Math.max(0, Math.min(254, Math.round(254 * force / end)))]

  // Side of the square that the map covers, mm.
  const extent = shape => answer?.force_map_mm ?? shape.force_map_mm

  // The net's own map: one pixel each, row 0 at the lowest y; drawn once more only when it is new.
  function paint(map) {
    if (!view.shape) return
    const tip = view.shape.tip_diameter_mm, whole = extent(view.shape)
    const n = Math.round(Math.sqrt(map.length))
    if (n !== side) {
      side = n
      board = el('canvas', { width: n, height: n })
      image = new ImageData(n, n)
    }
    // A contact of `end` newtons spread over a tip fills the colours.
    const full = end / (Math.PI * (tip / 2) ** 2) * (whole / n) ** 2, pixels = image.data
    for (let row = 0; row < n; row += 1) {
      for (let column = 0; column < n; column += 1) {
        const value = map[row * n + column], at = 4 * ((n - 1 - row) * n + column), rgb = palette[Math.max(0, Math.min(254, Math.round(254 * value / full)))]
        pixels[at] = rgb[0]
        pixels[at + 1] = rgb[1]
        pixels[at + 2] = rgb[2]
        pixels[at + 3] = value > 0.02 * full ? 255 : 0
      }
    }
    board.getContext('2d').putImageData(image, 0, 0)
  }

  function draw(pen, view, shape) {
    if (!answer) return
    const unsure = answer.outside?.length > 0
    if (answer.force_map_n) {
      const whole = extent(shape), left = shape.width_mm / 2 - whole / 2, top = shape.height_mm / 2 + whole / 2
      pen.save()
      pen.beginPath()
      pen.rect(view.x(0), view.y(shape.height_mm), shape.width_mm * view.scale, shape.height_mm * view.scale)
      pen.clip()
      pen.imageSmoothingEnabled = true
      pen.drawImage(board, view.x(left), view.y(top), whole * view.scale, whole * view.scale)
      pen.restore()
    }
    for (const other of answer.alternatives ?? []) outline(pen, view, shape, other)
    pen.font = '600 15px system-ui, sans-serif'
    pen.textBaseline = 'middle'
    pen.textAlign = 'left'
    for (const contact of answer.contacts) {
      const x = view.x(contact.x_mm), y = view.y(contact.y_mm), r = shape.tip_diameter_mm / 2 * view.scale
      if (!answer.force_map_n) {
        const rgb = shade(contact.force_n ?? end / 2)
        disc(pen, x, y, r, { fill: `rgb(${rgb[0]} ${rgb[1]} ${rgb[2]})` })
      }
      pen.strokeStyle = unsure ? ink.unsure : ink.line
      pen.lineWidth = 1.5
      if (contact.x_sd_mm != null && contact.y_sd_mm != null) {
        pen.setLineDash(unsure ? [4, 4] : [])
        pen.beginPath()
        pen.ellipse(x, y, Math.max(2, SDS * contact.x_sd_mm * view.scale), Math.max(2, SDS * contact.y_sd_mm * view.scale), 0, 0, 7)
        pen.stroke()
        pen.setLineDash([])
      }
      const words = `${contact.number}: ${contact.force_n == null ? 'force unknown' : fixed(contact.force_n, 1, 'N')}`
      const right = x + r + 6 + 90 < view.width
      pen.textAlign = right ? 'left' : 'right'
      lettering(pen, words, right ? x + r + 6 : x - r - 6, y, ink.text, ink.ground)
    }
  }

  // The contacts of another explanation: thin ellipses with its probability, without colours.
  function outline(pen, view, shape, { probability, contacts }) {
    pen.save()
    pen.globalAlpha = 0.55
    pen.lineWidth = 1
    pen.setLineDash([2, 3])
    pen.strokeStyle = ink.line
    pen.fillStyle = ink.text
    pen.font = '12px system-ui, sans-serif'
    pen.textBaseline = 'bottom'
    pen.textAlign = 'center'
    const tip = shape.tip_diameter_mm / 2
    for (const contact of contacts) {
      const x = view.x(contact.x_mm), y = view.y(contact.y_mm)
      const [rx, ry] = [contact.x_sd_mm, contact.y_sd_mm].map(sd => Math.max(2, (sd == null ? tip : SDS * sd) * view.scale))
      pen.beginPath()
      pen.ellipse(x, y, rx, ry, 0, 0, 7)
      pen.stroke()
      pen.fillText(fixed(100 * probability, 0, '%'), x, y - ry - 2)
    }
    pen.restore()
  }
  function describe() { return answer ? `The skin with ${answer.contacts.length} contacts; the table next to it lists them.` : 'The skin; no answer yet.' }

  function tellLegend() {
    const tip = view.shape ? ` of ${fixed(view.shape.tip_diameter_mm, 0, 'mm')}` : ''
    fill(legend, el('span', {}, '0'), strip(i => palette[i]), el('span', {}, `${fixed(end, 0, 'N')} on one contact${tip}`),
      el('span', {}, 'Ellipse: 2 standard deviations of the place, where the method knows them. Dotted: another explanation, with its probability'))
  }
  dark.addEventListener('change', () => { palette = sequential(); ink = inks(); tellLegend(); view.redraw() }, { signal })
  tellLegend()
  return {
    node: el('div', {}, view.node, legend),
    geometry(next) {
      view.geometry(next)
      tellLegend()
      if (answer?.force_map_n) paint(answer.force_map_n)
    },
    show(next) {
      answer = next
      if (next?.force_map_n) paint(next.force_map_n)
      view.redraw()
    },
    scale(n) { if (n !== end) { end = n; tellLegend(); if (answer?.force_map_n) paint(answer.force_map_n); view.redraw() } },
  }
}
