// Box plots side by side: median, quartiles, whiskers, and the share of values beyond them.

import { cellKeys } from './cellkeys.js'
import { colour, el, onLook, say, soon } from './dom.js'
import { about, count, percent } from './format.js'
import { roundUp } from './frame.js'
import { line, sharp } from './pen.js'
import { picture } from './picture.js'

const height = 200
const FOURTHS = [1, 2, 4, 6, 8, 10] // Four parts divide them well.

/**
 * Makes a box plot. `set([{ name, trials, low, q1, median, q3, high, outliers }])`. `paper`: a published
 * value, drawn as a dashed line.
 */
export function boxes({ title, unit = '', factor = 1, paper, query, label, signal }) {
  const canvas = el('canvas', { className: 'boxes', style: { height: `${height}px` } }), at = el('p', { className: 'chart-at', 'aria-hidden': 'true', style: { top: `${height}px` } })
  const holder = el('div', { className: 'chart' }, canvas, at)
  let items = [], marked = null // The box that is read by keys.
  const draw = soon(() => {
    const width = canvas.clientWidth
    if (!width) return
    const pen = sharp(canvas, width, height)
    pen.font = '12px system-ui, sans-serif'
    const top = roundUp(Math.max(...items.map(item => item.high * factor), paper ?? 0, 1e-9), FOURTHS), left = 50, foot = 36, head = 10
    const y = value => height - foot - (height - foot - head) * value / top
    grid(pen, { top, left, width, y })
    items.forEach((item, i) => one(pen, { ...item, isMarked: i === marked }, left + (width - left) * (i + 0.5) / items.length, Math.min(46, (width - left) / items.length * 0.5), y))
    if (paper) dashed(pen, { left, width, y: y(paper) })
    canvas.ariaLabel = `${title}: ${items.map(words).join('; ')}`
  })
  const words = item => `${item.name}: median ${about(item.median * factor, unit)}, quartiles ${about(item.q1 * factor)} to ${about(item.q3 * factor, unit)}, whiskers ${about(item.low * factor)} to ${about(item.high * factor, unit)}, ${count(item.trials)} trials`
  function grid(pen, { top, left, width, y }) {
    pen.textBaseline = 'middle'
    for (let k = 0; k <= 4; k += 1) {
      pen.strokeStyle = colour('--line')
      pen.fillStyle = colour('--soft')
      pen.textAlign = 'right'
      line(pen, [left, y(top * k / 4)], [width, y(top * k / 4)])
      pen.fillText(k ? about(top * k / 4) : `0 ${unit}`, left - 6, y(top * k / 4))
    }
  }
  function one(pen, item, x, wide, y) {
    const [low, q1, median, q3, high] = [item.low, item.q1, item.median, item.q3, item.high].map(v => y(v * factor))
    pen.strokeStyle = colour('--c1')
    pen.lineWidth = 1.5
    for (const [from, to] of [[low, q1], [q3, high]]) line(pen, [x, from], [x, to])
    for (const end of [low, high]) line(pen, [x - wide / 4, end], [x + wide / 4, end])
    pen.fillStyle = `${colour('--c1')}30`
    pen.fillRect(x - wide / 2, q3, wide, q1 - q3)
    pen.strokeRect(x - wide / 2, q3, wide, q1 - q3)
    pen.lineWidth = 3
    line(pen, [x - wide / 2, median], [x + wide / 2, median])
    pen.lineWidth = 1
    pen.textAlign = 'center'
    pen.fillStyle = colour('--ink')
    if (item.isMarked) pen.fillRect(x - wide / 2, height - 16, wide, 2)
    pen.fillText(item.name, x, height - 25)
    pen.fillStyle = colour('--soft')
    pen.fillText(`n ${count(item.trials)}`, x, height - 9)
  }
  function dashed(pen, { left, width, y }) {
    pen.strokeStyle = colour('--soft')
    pen.setLineDash([5, 4])
    line(pen, [left, y], [width, y])
    pen.setLineDash([])
  }
  onLook(canvas, draw, signal)
  const data = () => ({ heads: ['group', 'trials', 'low', 'q1', 'median', 'q3', 'high', 'share beyond'],
    rows: items.map(item => [item.name, item.trials, item.low, item.q1, item.median, item.q3, item.high, percent(item.outliers, 1)]) })
  const mark = i => {
    marked = i < items.length ? i : null
    draw()
    return say(at, marked == null ? '' : words(items[marked])).textContent
  }
  cellKeys(canvas, { kind: 'box plot', keys: 'On a box plot', size: () => [items.length, 1], show: cell => mark(cell?.[0]) })
  const node = picture({ title, query, label, data, canvas: () => canvas }, holder)
  return { node, set(next) { items = next; mark(marked) } }
}
