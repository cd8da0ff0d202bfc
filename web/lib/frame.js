// A frame as a picture: 28 injections by 28 channels, the same colours for the same voltage everywhere.

import { colour, dark, el, say, soon } from './dom.js'
import { count, fixed } from './format.js'
import { picture } from './picture.js'

// Linear up to BEND of the scale's end, logarithmic beyond: far channels stay visible.
const BEND = 0.15
const FULL = Math.asinh(1 / BEND), bend = u => Math.asinh(u / BEND) / FULL, unbend = t => Math.sinh(t * Math.asinh(1 / BEND)) * BEND

/** 255 colours: blue below zero, orange above; zero is the page's own ground. */
export function diverging() {
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

/** 1, 2 or 5 times a power of ten, at least `top`. */
export function round125(top) {
  const ten = 10 ** Math.floor(Math.log10(Math.max(top, 1e-9)))
  return [1, 2, 5, 10].map(n => n * ten).find(n => n >= top * 0.999)
}

/**
 * Makes a picture of a frame. `show(values, { scale, marks })`: 784 voltages, injection-major;
 * `scale` is the end of the colours (else it grows as 1, 2, 5 and stands still otherwise); `marks`
 * { stuck, saturated, missing }: lists of channels, drawn as crosses.
 */
export function frame({ title = 'Frame', size = 28, unit = 'V', name, query, label, signal } = {}) {
  const map = el('canvas', { width: size, height: size, className: 'frame', role: 'img', 'aria-label': title })
  const bar = strip(i => [i, i, i], 'colours')
  const ticks = el('div', { className: 'ticks' }), at = el('p', { className: 'soft hover' })
  let values = null, marks = {}, end = 0, words = null
  const paintBar = () => {
    const palette = diverging()
    paintStrip(bar, i => palette[i])
    words = Uint32Array.from(palette, ([r, g, b]) => 0xff000000 | b << 16 | g << 8 | r) // Bytes r, g, b, a in memory.
  }
  const image = new ImageData(size, size), pixels = new Uint32Array(image.data.buffer)
  const draw = soon(() => {
    if (!values) return
    pixels.fill(0)
    let low = Infinity, high = -Infinity
    for (let i = 0; i < values.length; i += 1) {
      const v = values[i]
      if (missing(v)) continue
      if (v < low) low = v
      if (v > high) high = v
      pixels[i] = words[Math.round(127 + 127 * Math.max(-1, Math.min(1, bend(v / end))))]
    }
    const pen = map.getContext('2d')
    pen.putImageData(image, 0, 0)
    pen.fillStyle = colour('--bad')
    for (const channel of [...marks.stuck ?? [], ...marks.saturated ?? []]) pen.fillRect(channel % size, Math.floor(channel / size), 1, 1)
    map.ariaLabel = `${title}: voltages by injection and channel, from ${fixed(low, 4)} to ${fixed(high, 4, unit)}`
  })
  const tell = () => {
    const digits = v => Math.max(0, 1 - Math.floor(Math.log10(Math.abs(v))))
    ticks.replaceChildren(...[-1, -0.5, 0, 0.5, 1].map(t => unbend(t) * end).map(v => el('span', {}, v ? fixed(v, digits(v)) : `0\u202f${unit}`)))
  }
  map.onpointermove = event => {
    const box = map.getBoundingClientRect()
    const [channel, injection] = [event.clientX - box.left, event.clientY - box.top].map(v => Math.max(0, Math.min(size - 1, Math.floor(v / box.width * size))))
    say(at, values ? `injection ${injection}, channel ${channel}: ${fixed(values[injection * size + channel], 4, unit)}` : '')
  }
  map.onpointerleave = () => say(at, '')
  dark.addEventListener('change', () => { paintBar(); draw() }, { signal })
  paintBar()
  const node = picture({
    title, name, query, label, canvas: () => map,
    data: () => ({ heads: ['injection', 'channel', unit === 'V' ? 'voltage_v' : `value_${unit}`], rows: Array.from(values ?? [], (v, i) => [Math.floor(i / size), i % size, missing(v) ? null : v]) }),
  }, el('div', { className: 'frame-box' }, el('div', { className: 'side', 'aria-hidden': 'true' }, el('span', {}, String(size - 1)), el('span', {}, 'injection'), el('span', {}, '0')), map,
    el('div', { className: 'ticks', 'aria-hidden': 'true' }, el('span', {}, '0'), el('span', {}, 'channel'), el('span', {}, String(size - 1))), bar, ticks), at)
  // The end of the colours where none is given: it grows as 1, 2, 5 and does not change otherwise.
  const grown = next => {
    let top = 1e-6
    for (const v of next) if (!missing(v) && Math.abs(v) > top) top = Math.abs(v)
    return top > end || top < 0.2 * end ? round125(top) : end
  }
  return {
    node,
    show(next, { scale, marks: marked } = {}) {
      values = next
      marks = marked ?? {}
      if (!next) return
      const wanted = scale ?? grown(next)
      if (wanted !== end) { end = wanted; tell() }
      draw()
    },
    marked: () => count((marks.stuck?.length ?? 0) + (marks.saturated?.length ?? 0)),
  }
}
