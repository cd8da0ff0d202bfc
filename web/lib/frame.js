// A frame as a picture: injections by channels, the same colours for the same voltage everywhere.

import { cellKeys } from './cellkeys.js'
import { dark, el, say, soon } from './dom.js'
import { count, fixed, listed } from './format.js'
import { picture } from './picture.js'

// Linear up to BEND of the scale's end, logarithmic beyond: far channels stay visible.
const BEND = 0.15
const FULL = Math.asinh(1 / BEND), bend = u => Math.asinh(u / BEND) / FULL, unbend = t => Math.sinh(t * Math.asinh(1 / BEND)) * BEND

/** 255 colours: blue below zero, orange above; zero is the page's own ground. */
function diverging() {
  const stops = dark.matches ? [[150, 205, 255], [45, 110, 190], [28, 31, 35], [190, 85, 25], [255, 205, 140]]
    : [[8, 48, 107], [88, 150, 205], [247, 247, 244], [230, 140, 70], [125, 40, 5]]
  return shades(stops)
}

/** 255 colours from the ground to full: for what has no sign, as force or FVU. */
export function sequential() {
  return shades(dark.matches ? [[28, 31, 35], [32, 74, 92], [32, 130, 116], [122, 186, 88], [253, 231, 100]]
    : [[247, 247, 244], [168, 214, 170], [60, 160, 130], [30, 95, 115], [45, 25, 85]])
}

function shades(stops) {
  const shade = (t, k = Math.min(stops.length - 2, Math.floor(t))) => stops[k].map((c, j) => Math.round(c + (stops[k + 1][j] - c) * (t - k)))
  return Array.from({ length: 255 }, (_, i) => shade(i / 254 * (stops.length - 1)))
}

/** Paints a canvas of 255 pixels with the colours that `shade(i)` gives as [r, g, b]. */
export function paintStrip(canvas, shade) {
  const image = new ImageData(255, 1)
  for (let i = 0; i < 255; i += 1) image.data.set([...shade(i), 255], 4 * i)
  canvas.getContext('2d').putImageData(image, 0, 0)
  return canvas
}

/** Makes such a canvas: the colours of a legend. */
export const strip = (shade, className = 'shades') => paintStrip(el('canvas', { width: 255, height: 1, className, 'aria-hidden': 'true' }), shade)

/** Difference of two frames; NaN where one has no value; null if they are no pair. Numbers alone: ten frames per second leave no garbage. */
export function minus(a, b) {
  if (!a || !b || a.length !== b.length) return null
  const rest = new Float32Array(a.length)
  for (let i = 0; i < rest.length; i += 1) rest[i] = a[i] == null || b[i] == null ? NaN : a[i] - b[i]
  return rest
}

const missing = v => v == null || Number.isNaN(v)

/** One of `steps` times a power of ten, at least `top`. */
export function roundUp(top, steps = [1, 2, 5, 10]) {
  const ten = 10 ** Math.floor(Math.log10(Math.max(top, 1e-9)))
  return steps.map(n => n * ten).find(n => n >= top * 0.999)
}

/**
 * Width and height of the picture of `n` values: channels by injections. 784 are 28 by 28; another square number is a
 * square as well. Others are one row of channels, since their number alone does not state the injections.
 */
function sizeOf(n) {
  const side = Math.round(Math.sqrt(n))
  return side * side === n ? [side, side] : [n, 1]
}

// Pixels of the canvas per channel, so that a mark has some; fewer in a long row.
const CELL_PX = 16, ROW_PX = 1024, ROW_ASPECT = 8

// Half width of a mark, in pixels of the page: it may be larger than its channel, which can be small.
const MARK_PX = { stuck: 4, saturated: 5.5 }

/** Draws the rim of a cell that a key reached, on the light and dark of all colours. */
function rim(pen, x, y, width, height, px) {
  for (const [ink, line] of [['#fff', 5], ['#000', 2]]) {
    pen.strokeStyle = ink
    pen.lineWidth = line * px
    pen.strokeRect(x, y, width, height)
  }
}

/** Draws a mark; `px` is a pixel of the page. A dark line on a light one is visible on every colour, in light and dark. */
function mark(pen, x, y, kind, px) {
  const r = MARK_PX[kind] * px
  pen.beginPath()
  if (kind === 'saturated') pen.arc(x, y, r, 0, 2 * Math.PI)
  else for (const [dx, dy] of [[r, r], [r, -r]]) { pen.moveTo(x - dx, y - dy); pen.lineTo(x + dx, y + dy) }
  for (const [ink, width] of [['#fff', 3.6], ['#000', 1.5]]) {
    pen.strokeStyle = ink
    pen.lineWidth = width * px
    pen.stroke()
  }
}

/**
 * Makes a picture of a frame. `show(values, { scale, marks })`: voltages, injection-major (see `sizeOf`);
 * `scale` is the end of the colours (else it grows as 1, 2, 5 and does not change otherwise); `marks`
 * { stuck, saturated }: lists of channels, drawn as crosses and as rings.
 */
export function frame({ title, name, query, label, signal }) {
  let size = [28, 28], cell = CELL_PX
  const map = el('canvas', { className: 'frame', 'aria-label': title }), small = el('canvas')
  const bar = strip(i => [i, i, i], 'colours')
  const ticks = el('div', { className: 'ticks' }), at = el('p', { className: 'soft hover' })
  const side = el('div', { className: 'side', 'aria-hidden': 'true' }), foot = el('div', { className: 'ticks', 'aria-hidden': 'true' })
  let values = null, marks = {}, end = 0, words = null, pointed = null, reached = null, marked = ''
  const paintBar = () => {
    const palette = diverging()
    paintStrip(bar, i => palette[i])
    words = Uint32Array.from(palette, ([r, g, b]) => 0xff000000 | b << 16 | g << 8 | r) // Bytes r, g, b, a in memory.
  }
  let image, pixels
  const shape = next => {
    const [width, height] = size = next
    pointed = reached = null
    image = new ImageData(width, height)
    pixels = new Uint32Array(image.data.buffer)
    cell = height > 1 ? CELL_PX : Math.max(1, Math.floor(ROW_PX / width))
    Object.assign(small, { width, height })
    Object.assign(map, { width: width * cell, height: height > 1 ? height * cell : Math.ceil(width * cell / ROW_ASPECT) })
    map.style.aspectRatio = String(height > 1 ? 1 : ROW_ASPECT)
    side.replaceChildren(...height > 1 ? [height - 1, 'injection', 0].map(text => el('span', {}, String(text))) : [])
    foot.replaceChildren(...[0, 'channel', width - 1].map(text => el('span', {}, String(text))))
  }
  const draw = soon(() => {
    const pen = map.getContext('2d'), [width, height] = size, tall = map.height / height
    pen.clearRect(0, 0, map.width, map.height) // Without a frame nothing of an earlier one may stay.
    tellCell()
    if (!values?.length) return void (map.ariaLabel = `${title}: no frame`)
    pixels.fill(0)
    let low = Infinity, high = -Infinity
    for (let i = 0; i < values.length; i += 1) {
      const v = values[i]
      if (missing(v)) continue
      if (v < low) low = v
      if (v > high) high = v
      pixels[i] = words[Math.round(127 + 127 * Math.max(-1, Math.min(1, bend(v / end))))]
    }
    small.getContext('2d').putImageData(image, 0, 0)
    pen.imageSmoothingEnabled = false
    pen.drawImage(small, 0, 0, map.width, map.height)
    const px = !marked && !reached ? 1 : map.width / (map.clientWidth || map.width)
    for (const kind of ['stuck', 'saturated']) for (const i of marks[kind] ?? []) mark(pen, (i % width + 0.5) * cell, (Math.floor(i / width) + 0.5) * tall, kind, px)
    if (reached) rim(pen, reached[0] * cell, reached[1] * tall, cell, tall, px)
    // A reader would read a label that changes under its focus again and again.
    if (document.activeElement !== map) map.ariaLabel = low > high ? `${title}: no values` : `${title}: voltages by ${height > 1 ? 'injection and ' : ''}channel, from ${fixed(low, 4)} to ${fixed(high, 4, 'V')}${marked && `; channels: ${marked.replace(/[\u00d7\u25cb] /g, '')}`}`
    return undefined
  })
  const tell = () => {
    const digits = v => Math.max(0, 1 - Math.floor(Math.log10(Math.abs(v))))
    ticks.replaceChildren(...[-1, -0.5, 0, 0.5, 1].map(t => unbend(t) * end).map(v => el('span', {}, v ? fixed(v, digits(v)) : '0\u202fV')))
  }
  function cellWords([channel, injection]) {
    if (!values?.length) return 'No frame.'
    const i = injection * size[0] + channel, kinds = Object.keys(MARK_PX).filter(kind => marks[kind]?.includes(i))
    return `${listed([size[1] > 1 && `injection ${injection}`, `channel ${channel}`])}: ${[fixed(values[i], 4, 'V'), ...kinds].join(', ')}`
  }
  // One line, so that nothing moves: the cell under the pointer or reached by a key, else how many channels are marked.
  function tellCell() {
    const place = pointed ?? reached, tone = `hover ${place || !marked ? 'soft' : 'warn'}`
    say(at, place && values?.length ? cellWords(place) : marked)
    if (at.className !== tone) at.className = tone
  }
  map.onpointermove = event => {
    const box = map.getBoundingClientRect()
    const part = [(event.clientX - box.left) / box.width, (event.clientY - box.top) / box.height]
    pointed = part.map((share, k) => Math.max(0, Math.min(size[k] - 1, Math.floor(share * size[k]))))
    tellCell()
  }
  map.onpointerleave = () => { pointed = null; tellCell() }
  cellKeys(map, { size: () => size, show(to) {
    reached = to
    draw()
    tellCell()
    return to ? cellWords(to) : ''
  } })
  dark.addEventListener('change', () => { paintBar(); draw() }, { signal })
  paintBar()
  const node = picture({
    title, name, query, label, canvas: () => map,
    data() {
      const [width, height] = size, places = i => height > 1 ? [Math.floor(i / width), i % width] : [i]
      return { heads: [...height > 1 ? ['injection'] : [], 'channel', 'voltage_v'], rows: Array.from(values ?? [], (v, i) => [...places(i), missing(v) ? null : v]) }
    },
  }, el('div', { className: 'frame-box' }, side, map, foot, bar, ticks), at)
  shape(size)
  // The end of the colours where none is given: it grows as 1, 2, 5 and does not change otherwise.
  const grown = next => {
    let top = 1e-6
    for (const v of next) if (!missing(v) && Math.abs(v) > top) top = Math.abs(v)
    return top > end || top < 0.2 * end ? roundUp(top) : end
  }
  return {
    node,
    show(next, { scale, marks: found } = {}) {
      values = next
      marks = found ?? {}
      const shown = [['stuck', '\u00d7'], ['saturated', '\u25cb']].filter(([kind]) => marks[kind]?.length)
      marked = next ? shown.map(([kind, sign]) => `${sign} ${count(marks[kind].length)} ${kind}`).join(', ') : ''
      if (!next?.length) return draw()
      if (next.length !== image.width * image.height) shape(sizeOf(next.length))
      const wanted = scale ?? grown(next)
      if (wanted !== end) { end = wanted; tell() }
      draw()
    },
  }
}
