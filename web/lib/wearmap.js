// Presses on each place of the skin: coloured discs with a legend, the places by number of presses, the most pressed ones.

import { chart } from './chart.js'
import { button, dark, el, facts, fill, pane } from './dom.js'
import { NONE, count, counted, fixed } from './format.js'
import { roundUp, sequential, strip } from './frame.js'
import { median } from './runwords.js'
import { disc } from './pen.js'
import { nearest, skin } from './skin.js'
import { table } from './table.js'

const MOST_PRESSED = 8
const NEAR_MM = 12
const DISC_MM = 7.4
const BARS_MOST = 40
// The first shades are those of the ground: a place that was pressed once must differ from it.
const FIRST_SHADE = 20
const shadeOf = u => Math.round(FIRST_SHADE + (254 - FIRST_SHADE) * u)

/** Makes the map: { map, most, spread } are sections; `show(points, shape)` draws, `choose(x, y)` marks a place. */
export function wearMap({ onchoose, label, signal }) {
  let points = { x_mm: [], y_mm: [], presses: [] }
  let order = []
  let places = 0
  let marked = null
  const query = '/api/v1/wear'
  const legend = el('p', { className: 'legend' })
  const chosen = el('p', { className: 'picked' })
  const most = el('section')
  const at = i => [points.x_mm[i], points.y_mm[i], points.presses[i]]
  const top = () => points.presses[order[0]] ?? 0
  const end = () => roundUp(Math.max(1, top()))

  const view = skin({
    title: 'Presses on each place',
    signal,
    label,
    query,
    draw,
    points: true,
    describe,
    onhover: mm => (mm ? words(near(mm)) : ''),
    onpick: mm => {
      pick(near(mm))
      return chosen.textContent
    },
    spots: () => order.map(i => [points.x_mm[i], points.y_mm[i]]), // The most pressed first.
    data: () => ({ heads: ['x_mm', 'y_mm', 'presses'], rows: order.map(at) }),
  })
  const series = [{ name: 'places', digits: 0, bars: true, fill: true, colour: '--c1' }]
  const range = (_, high) => [0, Math.max(1, (high || 1) * 1.1)]
  const spread = chart({ title: 'Places by their presses', key: 'places', time: false, x: 'Presses', y: 'Places', height: 170, signal, label, query, series, range })
  const spreadPart = pane(spread.node)
  dark.addEventListener('change', () => top() && tellLegend(), { signal })

  function describe() {
    if (!order.length) return 'Presses on the skin'
    return `Presses on ${count(places)} places of the skin: most ${count(top())}, median ${count(median(points.presses))}; see the table.`
  }
  function words(i) {
    if (i == null) return ''
    const [x, y, n] = at(i)
    return `x ${fixed(x, 0)}, y ${fixed(y, 0, 'mm')}: ${counted(n, 'press', 'presses')}, place ${order.indexOf(i) + 1} of ${count(places)}`
  }
  const near = mm => order[nearest(order.map(at), mm, NEAR_MM)] ?? null
  const pick = i => (i == null ? onchoose(null, null) : onchoose(Math.round(at(i)[0]), Math.round(at(i)[1])))
  function find(i) {
    pick(i)
    view.node.scrollIntoView({ block: 'nearest' }) // On a phone the map is beyond the table.
  }

  function draw(pen, v) {
    const shades = sequential()
    const radius = Math.max(1.5, DISC_MM * v.scale)
    const place = (i, radius, style) => disc(pen, v.x(points.x_mm[i]), v.y(points.y_mm[i]), radius, style)
    const styleOf = presses => (presses > 0 ? { fill: `rgb(${shades[shadeOf(presses / end())]})` } : { stroke: v.colour('--line'), width: 1 })
    for (const i of order) place(i, radius, styleOf(points.presses[i]))
    if (marked != null) place(marked, radius + 2, { stroke: v.colour('--ink'), width: 2.5 })
  }
  function tellLegend() {
    const shades = sequential()
    const bar = strip(i => shades[shadeOf(i / 254)])
    fill(legend, el('span', {}, '1'), bar, el('span', {}, counted(end(), 'press', 'presses')), el('span', {}, el('i', { className: 'none' }), 'never'))
  }

  function tellMost() {
    const used = points.presses.filter(n => n > 0)
    const usual = median(used)
    const where = i => `x ${fixed(at(i)[0], 0)}, y ${fixed(at(i)[1], 0, 'mm')}`
    const showing = i => button('Show', () => find(i), { className: 'plain small', 'aria-label': `Show the place at ${where(i)}` })
    const columns = [
      { head: 'Place', left: true, cell: where },
      { head: 'Presses', cell: i => count(points.presses[i]) },
      { head: 'Of the median', cell: i => (usual ? `${fixed(points.presses[i] / usual, 1)}\u202f×` : NONE) },
      { head: 'Show', cell: showing },
    ]
    const list = facts([
      ['Presses in all', count(points.presses.reduce((a, b) => a + b, 0))],
      ['Places', count(places)],
      ['Never pressed', count(places - used.length)],
      used.length > 0 && ['Median of the others', count(usual)],
      used.length > 0 && ['Most', count(top())],
    ])
    const rows = order.slice(0, MOST_PRESSED).filter(i => points.presses[i] > 0)
    fill(most, el('h2', {}, 'The most pressed places'), list, table({ rows, columns, empty: 'No place has been pressed yet.' }).node)
  }
  function drawSpread() {
    const width = Math.max(1, Math.ceil(end() / BARS_MOST))
    const bins = new Array(Math.floor(end() / width) + 1).fill(0)
    for (const n of points.presses) bins[Math.floor(n / width)] += 1
    spread.set([[-width, ...bins.map((_, i) => i * width), bins.length * width], [null, ...bins, null]])
  }

  function choose(x, y) {
    marked = x == null ? null : near([x, y])
    fill(chosen, marked == null ? '' : `Chosen: ${words(marked)}.`)
    view.redraw()
  }
  function show(next, shape) {
    points = next
    order = points.presses.map((_, i) => i).sort((a, b) => points.presses[b] - points.presses[a])
    // A place that was never pressed may be absent.
    places = Math.max(order.length, shape?.points_mm.length ?? 0)
    tellMost()
    drawSpread()
    spreadPart.hidden = !top()
    if (shape) {
      if (top()) tellLegend()
      else fill(legend, 'No place has been pressed yet: the first run colours this map.')
      view.geometry(shape)
    } else fill(legend, 'The service does not describe the sensor, so the skin cannot be drawn.')
  }
  return { map: pane(view.node, legend, chosen), most, spread: spreadPart, show, choose }
}
