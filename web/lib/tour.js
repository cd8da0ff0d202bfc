// The tour of a plan, drawn on the skin: a thin line in the order of driving, coloured from first to last, and a
// position that walks along it with its tips to scale.

import { button, dark, el, fill, say } from './dom.js'
import { count, counted, fixed } from './format.js'
import { paintStrip, sequential } from './frame.js'
import { disc, line, sharp } from './pen.js'
import { nearest, skin, tips } from './skin.js'
import { places } from './tourmap.js'

const BINS = 96
const TRAIL = 10

const middle = contacts => contacts.reduce(([x, y], c) => [x + c[0] / contacts.length, y + c[1] / contacts.length], [0, 0])

/**
 * Makes the drawing. `show(tour, sensor, { tips, step })`: `tips` keeps one setting, `step` (from 0) is
 * an index into the whole tour. `onstep(step)` is called when a person has chosen one.
 */
export function tourView({ onstep, label, query, signal }) {
  let tour = null
  let shape = null
  let kept = []
  let middles = []
  let pressed = [] // Places of the kept steps, with the numbers of these.
  let spots = []
  let at = 0
  let bitmap = null
  let drawn = ''
  const shades = () => {
    const all = sequential()
    return i => all[Math.round(56 + i * 198)]
  }

  const view = skin({
    title: 'Tour',
    label,
    query,
    signal,
    draw,
    tall: true,
    describe: () => (tour ? `Tour of ${counted(kept.length, 'step')} over the skin; ${words()}` : 'Tour'),
    data: () => ({
      heads: ['step', 'configuration', 'tips', 'x_mm', 'y_mm'],
      rows: kept.flatMap(i => tour.steps.contacts_mm[i].map(([x, y]) => [i + 1, tour.steps.configuration[i], tour.steps.tips[i], x, y])),
    }),
    onhover: mm => (mm && kept.length ? describe(near(mm)) : ''),
    onpick: mm => {
      if (kept.length) {
        walk(near(mm))
        onstep(kept[at])
      }
      return words()
    },
    spots: () => spots,
    turn: n => {
      by(n)
      return words()
    },
  })
  const slider = el('input', { type: 'range', id: 'tour-step', min: 0, max: 0, value: 0, 'aria-describedby': 'tour-words' })
  const told = el('p', { id: 'tour-words' })
  const colours = el('canvas', { width: 255, height: 1, className: 'colours', 'aria-hidden': 'true' })
  slider.addEventListener('input', () => walk(Number(slider.value)))
  slider.addEventListener('change', () => onstep(kept[at]))
  const by = n => {
    walk(at + n)
    onstep(kept[at])
  }
  const node = el('div', { className: 'tour' },
    view.node,
    el('div', { className: 'tour-scale soft small' },
      el('span', {}, 'first'),
      colours,
      el('span', {}, 'last'),
      el('span', {}, 'The line joins the middles of the contacts.'),
    ),
    el('label', { htmlFor: 'tour-step' }, 'Step of the tour'),
    slider,
    el('div', { className: 'row' }, button('Back', () => by(-1)), button('Forward', () => by(1)), told),
  )

  /** The first kept step that presses the place nearest to a position. */
  const near = mm => pressed[nearest(spots, mm)]?.of[0] ?? 0
  function describe(i) {
    const step = kept[i]
    const contacts = tour.steps.contacts_mm[step]
    const places = contacts.map(([x, y]) => `${fixed(x, 0)}, ${fixed(y, 0)}`).join('; ')
    const what = counted(contacts.length, tour.kind === 'real-random' ? 'weight' : 'tip')
    return `step ${count(step + 1)} of ${count(tour.steps.tips.length)}: configuration ${tour.steps.configuration[step]}, ${what} at ${places} mm`
  }
  const words = () => (kept.length ? describe(at) : 'no step')
  function walk(i) {
    at = Math.max(0, Math.min(kept.length - 1, i))
    slider.value = at
    slider.setAttribute('aria-valuetext', words())
    say(told, words())
    view.redraw()
  }

  // The whole line once as a bitmap: the walk draws only what moves.
  function course(v) {
    const name = `${v.width} ${v.height} ${dark.matches} ${kept.length} ${kept[0]}`
    if (drawn === name && bitmap) return bitmap
    drawn = name
    bitmap = el('canvas')
    const pen = sharp(bitmap, v.width, v.height)
    const shade = shades()
    const points = middles.map(([x, y]) => [v.x(x), v.y(y)])
    pen.lineWidth = kept.length > 2000 ? 0.35 : kept.length > 300 ? 0.7 : 1.2
    pen.lineJoin = 'round'
    const each = Math.max(1, Math.ceil(kept.length / BINS))
    for (let from = 0; from < kept.length; from += each) {
      pen.strokeStyle = `rgb(${shade(from / kept.length)})`
      line(pen, ...points.slice(from, from + each + 1))
      if (kept.length <= 600) for (const [x, y] of points.slice(from, from + each)) disc(pen, x, y, 2.2, { fill: pen.strokeStyle })
    }
    paintStrip(colours, i => shade(i / 254))
    return bitmap
  }
  function draw(pen, v) {
    if (!kept.length) return
    pen.drawImage(course(v), 0, 0, v.width, v.height)
    // The way that led here, fading.
    pen.strokeStyle = v.colour('--ink')
    pen.lineWidth = 1.4
    for (let i = Math.max(1, at - TRAIL); i <= at; i += 1) {
      pen.globalAlpha = 0.15 + 0.85 * (1 - (at - i) / TRAIL) ** 2
      line(pen, ...[i - 1, i].map(k => [v.x(middles[k][0]), v.y(middles[k][1])]))
    }
    pen.globalAlpha = 1
    tips(pen, v, tour.steps.contacts_mm[kept[at]], shape.tip_diameter_mm, { fill: v.colour('--next'), stroke: v.colour('--panel') })
  }

  return {
    node,
    show(next, sensor, { tips: only, step } = {}) {
      tour = next
      shape = sensor
      kept = tour.steps.tips.map((n, i) => i).filter(i => only == null || tour.steps.tips[i] === only)
      middles = kept.map(i => middle(tour.steps.contacts_mm[i]))
      pressed = places({ contacts_mm: kept.map(i => tour.steps.contacts_mm[i]) })
      spots = pressed.map(({ x, y }) => [x, y])
      slider.max = Math.max(0, kept.length - 1)
      slider.disabled = kept.length < 2
      view.geometry(sensor)
      walk(step == null ? 0 : Math.max(0, kept.indexOf(step)))
      return fill(told, words())
    },
    go: step => {
      const i = kept.indexOf(step)
      if (i >= 0 && i !== at) walk(i)
    },
  }
}
