// The skin, drawn to scale and always the same way up: outline, electrodes, ruler, and what a page draws on it.

import { colour, dark, el, onLook, say, soon } from './dom.js'
import { get } from './api.js'
import { mapKeys } from './mapkeys.js'
import { disc, line, sharp } from './pen.js'
import { picture } from './picture.js'

const known = new Map()

/** Geometry of the sensor of a run, or of the one under the rig; asked for once. */
export function sensor(run) {
  const key = run ?? ''
  if (!known.has(key)) {
    const asked = get('/sensor', { run })
    known.set(key, asked)
    asked.catch(() => known.delete(key))
  }
  return known.get(key)
}

/** The same; where that of the run is not readable, the one under the rig. */
export const sensorOf = run => sensor(run).catch(() => sensor())

/**
 * Makes a drawing of the skin. `draw(pen, view)` draws over outline and electrodes, in pixels:
 * `view.x(mm)`, `view.y(mm)`, `view.scale` (pixels per mm), `view.colour(name)`. `onpick(mm, event)`
 * and `onhover(mm | null)` get positions on the skin, by pointer or by key, and may return words; `spots()` are the places
 * [x, y] that can be read, in their order, `turn(step)` what Page Up and Page Down do instead of going through them.
 * `describe()` returns the words for a reader.
 * `redraw()` draws again; `geometry(sensor)` gives the sensor.
 */
export function skin({ title = 'Skin', draw = () => {}, onpick, onhover, ondrag, describe = () => title, spots = () => [], turn, points = false, label, query, data, signal, tall = false }) {
  const canvas = el('canvas', { className: `skin${onpick || ondrag ? ' picks' : ''}`, role: 'img', 'aria-label': title })
  const words = el('p', { className: 'soft hover' })
  let shape = null, view = null, reached = null, ground = null, groundOf = '', groundShape = null
  const redraw = soon(() => {
    const width = canvas.clientWidth, height = canvas.clientHeight
    if (!shape || !width) return
    const ratio = window.devicePixelRatio || 1, pen = canvas.getContext('2d')
    const size = [width, height].map(side => Math.round(side * ratio))
    if (canvas.width !== size[0] || canvas.height !== size[1]) [canvas.width, canvas.height] = size
    const room = 16, foot = 26
    const scale = Math.min((width - 2 * room) / shape.width_mm, (height - room - foot) / shape.height_mm)
    const left = (width - scale * shape.width_mm) / 2, top = room
    view = { scale, width, height, colour, x: mm => left + mm * scale, y: mm => top + (shape.height_mm - mm) * scale, back: (px, py) => [(px - left) / scale, shape.height_mm - (py - top) / scale] }
    pen.setTransform(1, 0, 0, 1, 0, 0)
    pen.clearRect(0, 0, canvas.width, canvas.height)
    pen.drawImage(background(), 0, 0)
    pen.setTransform(ratio, 0, 0, ratio, 0, 0)
    pen.lineJoin = 'round'
    draw(pen, view, shape)
    if (reached) sight(pen)
    // A reader would read a label that changes under its focus again and again.
    if (document.activeElement !== canvas) canvas.ariaLabel = describe()
  })
  // Where the keys are: a ring with four ticks, light on dark, seen on every colour.
  function sight(pen) {
    const x = view.x(reached[0]), y = view.y(reached[1])
    for (const [ink, width] of [['--panel', 5], ['--ink', 2]]) {
      pen.strokeStyle = colour(ink)
      pen.lineWidth = width
      pen.beginPath()
      pen.arc(x, y, 9, 0, 7)
      for (const [dx, dy] of [[1, 0], [-1, 0], [0, 1], [0, -1]]) { pen.moveTo(x + 9 * dx, y + 9 * dy); pen.lineTo(x + 16 * dx, y + 16 * dy) }
      pen.stroke()
    }
  }
  // Outline, electrodes, points and ruler: drawn again only with another size, sensor or light.
  function background() {
    const now = `${canvas.width} ${canvas.height} ${dark.matches}`
    if (ground && groundOf === now && groundShape === shape) return ground
    groundOf = now
    groundShape = shape
    ground = el('canvas')
    const pen = sharp(ground, view.width, view.height)
    pen.lineJoin = 'round'
    pen.fillStyle = colour('--skin')
    pen.strokeStyle = colour('--line')
    pen.lineWidth = 1.5
    pen.beginPath()
    const outline = shape.outline_mm?.length ? shape.outline_mm : [[0, 0], [shape.width_mm, 0], [shape.width_mm, shape.height_mm], [0, shape.height_mm]]
    outline.forEach(([x, y]) => pen.lineTo(view.x(x), view.y(y)))
    pen.closePath()
    pen.fill()
    pen.stroke()
    const dot = (x, y, radius, fill) => disc(pen, view.x(x), view.y(y), radius, { fill })
    if (points) for (const [x, y] of shape.points_mm) dot(x, y, Math.max(1, 1.6 * view.scale), colour('--track'))
    for (const { x_mm, y_mm } of shape.electrodes) dot(x_mm, y_mm, Math.max(2, 4 * view.scale), colour('--electrode'))
    ruler(pen)
    return ground
  }
  function ruler(pen) {
    const y = view.height - 9, from = view.x(0), to = view.x(100)
    pen.strokeStyle = pen.fillStyle = colour('--soft')
    pen.lineWidth = 1
    for (let mm = 0; mm <= 100; mm += 20) line(pen, [view.x(mm), y - (mm % 100 ? 3 : 6)], [view.x(mm), y])
    line(pen, [from, y], [to, y])
    pen.font = '11px system-ui, sans-serif'
    pen.textBaseline = 'alphabetic'
    pen.textAlign = 'left'
    pen.fillText('100 mm', to + 5, y)
  }
  const place = event => {
    const box = canvas.getBoundingClientRect()
    return view && view.back(event.clientX - box.left, event.clientY - box.top)
  }
  if (onpick) canvas.addEventListener('click', event => { const mm = place(event); if (mm) onpick(mm, event) })
  if (onhover) {
    canvas.addEventListener('pointermove', event => { const mm = place(event); if (mm) say(words, onhover(mm) ?? '') })
    canvas.addEventListener('pointerleave', () => say(words, onhover(null) ?? ''))
  }
  if (ondrag) for (const kind of ['pointerdown', 'pointermove', 'pointerup']) canvas.addEventListener(kind, event => { const mm = place(event); if (mm) ondrag(kind.slice(7), mm, event) })
  if (onhover || onpick) mapKeys(canvas, { spots, turn, pick: onpick, extent: () => [shape?.width_mm, shape?.height_mm], show(mm) {
    reached = mm
    redraw()
    say(words, onhover?.(mm) ?? '')
    return mm && (words.textContent || `x ${mm[0].toFixed(0)}, y ${mm[1].toFixed(0)} mm`)
  } })
  onLook(canvas, redraw, signal)
  const node = picture({ title, label, query, data, canvas: () => canvas, props: { className: `picture skin-box${tall ? ' tall' : ''}` } }, canvas, words)
  return { node, canvas, redraw, geometry(next) { shape = next; canvas.style.aspectRatio = `${next.width_mm + 20} / ${next.height_mm + 30}`; redraw() }, get shape() { return shape } }
}

/** Index of the place [x, y] that is nearest to a position, at most `within` mm from it; -1 without one. */
export function nearest(places, [x, y], within = Infinity) {
  let best = -1, least = within ** 2
  places.forEach(([px, py], i) => {
    const d = (px - x) ** 2 + (py - y) ** 2
    if (d < least) { least = d; best = i }
  })
  return best
}

/** Draws tips to scale. */
export function tips(pen, view, contacts, diameter, style) {
  for (const [x, y] of contacts) disc(pen, view.x(x), view.y(y), Math.max(2, diameter / 2 * view.scale), style)
}
