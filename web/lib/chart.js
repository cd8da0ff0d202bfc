// Charts of numbers over time or over another number, by uPlot.

import uPlot from '../vendor/uPlot.js'
import { hold } from './address.js'
import { chartKeys } from './chartkeys.js'
import { colour, dark, el } from './dom.js'
import { clock, day, fixed } from './format.js'
import { picture } from './picture.js'

const COLOURS = ['--c1', '--c2', '--c3', '--c4', '--c5', '--c6']
const DAY_S = 86_400
// A press that moves less is a click.
const DRAG_PX = 5

/** The zoom of an address: "low..high" as [low, high]; null of another text. */
function zoomOf(text) {
  const ends = (text ?? '').split('..').map(Number)
  return ends.length === 2 && ends.every(Number.isFinite) && ends[0] < ends[1] ? ends : null
}
const zoomText = ([low, high]) => [low, high].map(v => +v.toPrecision(12)).join('..')

/**
 * Makes a chart. `series`: [{ name, unit?, digits?, colour?, points?, line?, axis?: 'right', dash? }],
 * drawn from `set([x, y1, y2, …])`; x in Unix seconds if `time`. `marks(u)` may draw over it.
 * `range`: [low, high] of y, fixed, or a function (low, high) => [low, high].
 * `whole`: x is marked at whole numbers only. A drag or a key zooms along x: with `key`, a name that is unique in its page,
 * the zoom is in the address, and so are the curves that are hidden; with `onselect(low, high)` the page does the zoom
 * (null, null: the whole). `onenter(x)` opens what is near a point. Ends with `signal`.
 */
export function chart({ title, key, onenter, x = 'Time', xUnit, y = '', unit = '', series, time = true, height = 180, range, marks, query, label, signal, log = false, right, onselect, whole = false }) {
  const holder = el('div', { className: 'chart' })
  let data = [[], ...series.map(() => [])], plot = null, zoom = null, hidden = new Set() // Numbers of curves, from 1.
  const pen = (name, i) => colour(name ?? COLOURS[i % COLOURS.length])
  const text = (value, of) => value == null ? '' : fixed(value, of?.digits ?? 2, of?.unit ?? unit)
  const spread = (low, high) => {
    if (typeof range === 'function') return range(low, high)
    if (range) return range
    if (low == null || !Number.isFinite(low)) return [0, 1]
    const room = (high - low || Math.abs(high) || 1) * 0.08
    return [low >= 0 && low - room < 0 ? 0 : low - room, high + room]
  }
  const axis = more => ({ stroke: colour('--soft'), grid: { stroke: colour('--line'), width: 1 }, ticks: { show: false }, font: '12px system-ui, sans-serif', ...more })
  function make() {
    plot?.destroy()
    // Beyond a day a time alone would be ambiguous.
    const isLong = u => u.scales.x.max - u.scales.x.min > DAY_S
    const tick = (u, step) => t => isLong(u) ? `${day(t * 1e3)}${step < DAY_S ? ` ${clock(t * 1e3).slice(0, 5)}` : ''}` : clock(t * 1e3).slice(0, step < 60 ? 8 : 5)
    const cursor = (u, t) => `${isLong(u) ? `${day(t * 1e3)} ` : ''}${clock(t * 1e3)}`
    plot = new uPlot({
      width: Math.max(120, holder.clientWidth), height, padding: [8, 12, 0, 0],
      scales: { x: { time }, y: { range: (_, low, high) => spread(low, high), ...(log && { distr: 3, range: undefined }) }, ...(right && { right: { range: right.range ?? ((_, low, high) => spread(low, high)) } }) },
      axes: [axis({ size: time ? 28 : 44, space: time ? (_, i, low, high) => high - low > DAY_S ? 104 : 76 : 50, ...(time && { values: (u, ts) => ts.map(tick(u, ts.length > 1 ? ts[1] - ts[0] : 60)) }), ...(whole && { incrs: [0, 1, 2, 3, 4].flatMap(tens => [1, 2, 5].map(n => n * 10 ** tens)) }), ...(!time && { label: `${x}${xUnit ? `, ${xUnit}` : ''}`, labelSize: 18, labelFont: '12px system-ui, sans-serif' }) }),
        axis({ size: 52, ...(y && { label: `${y}${unit ? `, ${unit}` : ''}`, labelSize: 16, labelFont: '12px system-ui, sans-serif' }) }),
        ...(right ? [axis({ side: 1, scale: 'right', size: 46, grid: { show: false }, label: right.label, labelSize: 16, labelFont: '12px system-ui, sans-serif' })] : [])],
      series: [{ label: x, value: (u, v) => v == null ? '' : time ? cursor(u, v) : fixed(v, whole ? 0 : 2, xUnit) },
        ...series.map((one, i) => ({
          label: one.name, show: !hidden.has(i + 1), scale: one.axis === 'right' ? 'right' : 'y', stroke: pen(one.colour, i), width: one.line === false ? 0 : 1.5, dash: one.dash,
          points: { show: one.points ?? false, size: 4, fill: pen(one.colour, i) }, fill: one.fill ? `${pen(one.colour, i)}30` : undefined, paths: one.bars ? uPlot.paths.bars({ size: [0.9, 40] }) : one.steps ? uPlot.paths.stepped({ align: 1 }) : undefined,
          value: (_, v) => text(v, one), spanGaps: one.gaps ?? false,
        }))],
      cursor: { drag: { x: true, y: false, dist: DRAG_PX } },
      hooks: { draw: marks ? [marks] : [], setSeries: [noteHidden], setSelect: [u => { if (u.select.width > 0) zoomTo(u.posToVal(u.select.left, 'x'), u.posToVal(u.select.left + u.select.width, 'x')) }] },
      legend: { live: true },
    }, data, holder)
    holder.querySelector('canvas')?.setAttribute('aria-hidden', 'true')
    scale()
  }
  const scale = () => { if (zoom) plot?.setScale('x', { min: zoom[0], max: zoom[1] }) }
  // Hidden by a key or by a click in the legend.
  const noteHidden = (u, _, { show }) => {
    if (show == null) return
    hidden = new Set(series.map((_, i) => i + 1).filter(k => !u.series[k].show))
    keptHidden()
  }
  const keptHidden = key ? hold(`hide-${key}`, { take(text) {
    hidden = new Set(text.split(',').map(Number).filter(k => k > 0 && k <= series.length))
    const wanted = hidden // The plot reports each change by itself.
    for (const [k, one] of plot?.series.entries() ?? []) if (k > 0 && one.show === wanted.has(k)) plot.setSeries(k, { show: !wanted.has(k) })
  }, text: () => hidden.size ? [...hidden].join(',') : null, signal }) : () => {}
  const kept = key && !onselect ? hold(`zoom-${key}`, { take: text => { zoom = zoomOf(text); zoom ? scale() : plot?.setData(data) }, text: () => zoom && zoomText(zoom), signal }) : () => {}
  function zoomTo(low, high) {
    if (onselect) return onselect(low, high)
    zoom = [low, high]
    scale()
    return kept()
  }
  /** Shows the whole chart; returns whether a part was shown. */
  function zoomOut() {
    if (onselect) return onselect(null, null)
    const was = zoom != null
    zoom = null
    plot?.setData(data)
    kept()
    return was
  }
  const keys = chartKeys(holder, { title, x, names: series.map(one => one.name), height, plot: () => plot, zoom: { to: zoomTo, whole: zoomOut }, onenter })
  holder.addEventListener('dblclick', () => zoomOut())
  const sizes = new ResizeObserver(() => { if (!holder.clientWidth) return; plot ? plot.setSize({ width: holder.clientWidth, height }) : make() })
  sizes.observe(holder)
  dark.addEventListener('change', () => { if (plot) { make(); keys.refresh() } }, { signal })
  signal?.addEventListener('abort', () => { sizes.disconnect(); plot?.destroy() })
  const node = picture({
    title, label, query, canvas: () => holder.querySelector('canvas'),
    data: () => ({ heads: [`${x}${xUnit ? `, ${xUnit}` : ''}`, ...series.map(one => `${one.name}, ${one.unit ?? unit}`)], rows: data[0].map((v, i) => data.map((column, k) => k === 0 && time ? new Date(v * 1e3).toISOString() : column[i])) }),
  }, holder)
  return {
    node,
    set(columns) {
      data = columns
      // A part that has no data any more, as of a time that has passed, would be an empty chart.
      if (zoom && data[0].length && (data[0].at(-1) < zoom[0] || data[0][0] > zoom[1])) { zoom = null; kept() }
      plot?.setData(data)
      scale()
      keys.refresh()
    },
    get plot() { return plot },
  }
}
