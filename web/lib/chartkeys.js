// A chart by keyboard: a cursor that goes from point to point; what is at it is shown and spoken.
// Knows the plot alone: data, scales and cursor of uPlot.

import { el, say } from './dom.js'
import { counted } from './format.js'
import { byKeys, speak } from './speak.js'

const TURN = 10 // Page Up and Page Down: a tenth of the points that are shown.
const FOOT_PX = 30

/**
 * Makes `holder`, the element of a chart of `height` pixels, readable by keys. `plot()` is the uPlot or null. `zoom` has
 * `to(low, high)` and `whole()`, which returns whether the chart was zoomed. `onenter(x)` opens what is near a point and
 * may return its words. `refresh()` of the result is called after the plot has other data.
 */
export function chartKeys(holder, { title, x, names, height, plot, zoom, onenter }) {
  const at = el('p', { className: 'chart-at', 'aria-hidden': 'true', style: { top: `${height - FOOT_PX}px` } })
  let index = null
  let kept = null // The x of the cursor: its index changes with the data.
  holder.setAttribute('aria-label', `${title}: ${names.join(', ')} over ${x.toLowerCase()}`)
  holder.append(at)

  const curves = u => u.series.map((one, k) => ({ one, k })).filter(({ one, k }) => k > 0 && one.show)
  const has = (u, i) => curves(u).some(({ k }) => Number.isFinite(u.data[k][i]))
  const isSeen = (u, i) => u.data[0][i] >= u.scales.x.min && u.data[0][i] <= u.scales.x.max
  /** The first point from `from` on, in steps of `by`; null beyond the ends. */
  function seek(u, from, by) {
    for (let i = from; i >= 0 && i < u.data[0].length; i += by) if (has(u, i)) return i
    return null
  }
  const points = u => u.data[0].map((_, i) => i).filter(i => isSeen(u, i) && has(u, i))
  function words(u, i) {
    const values = curves(u).filter(({ k }) => Number.isFinite(u.data[k][i])).map(({ one, k }) => `${one.label} ${one.value(u, u.data[k][i], k, i)}`)
    return `${u.scales.x.time ? '' : `${x} `}${u.series[0].value(u, u.data[0][i], 0, i)}: ${values.join(', ')}`
  }

  /** Draws the cursor at the point; the scales are those after the present changes of the plot. */
  const mark = () => queueMicrotask(() => {
    const u = plot()
    if (!u || index == null) return
    const { one, k } = curves(u).find(({ k }) => Number.isFinite(u.data[k][index])) ?? {}
    if (!one) return
    u.setCursor({ left: u.valToPos(u.data[0][index], 'x'), top: u.valToPos(u.data[k][index], one.scale) })
    say(at, words(u, index))
  })
  function go(u, i, before = '') {
    if (i == null) return
    index = i
    kept = u.data[0][i]
    const { min, max } = u.scales.x
    if (!isSeen(u, i)) zoom.to(kept - (max - min) / 2, kept + (max - min) / 2)
    mark()
    speak(before + words(u, i))
  }
  /** Where the cursor begins: where it was, else at the newest point of a time, else at the first. */
  function start(u) {
    const all = points(u)
    if (!all.length) return void speak('No points.')
    const near = kept == null ? (u.scales.x.time ? all.at(-1) : all[0]) : all.reduce((a, b) => (Math.abs(u.data[0][b] - kept) < Math.abs(u.data[0][a] - kept) ? b : a))
    const end = i => u.series[0].value(u, u.data[0][i], 0, i)
    go(u, near, `${counted(all.length, 'point')}, ${end(all[0])} to ${end(all.at(-1))}. `)
  }
  function closer(u, factor) {
    const { min, max } = u.scales.x
    const middle = kept ?? (min + max) / 2
    const half = ((max - min) / 2) * factor
    const inside = u.data[0].filter(v => v >= middle - half && v <= middle + half).length
    if (factor < 1 && inside < 2) return speak('No closer: one point would be shown.')
    const [first, last] = [u.data[0][0], u.data[0].at(-1)]
    if (middle - half <= first && middle + half >= last) return far()
    const low = Math.max(first, Math.min(middle - half, last - 2 * half)) // Nothing is shown beyond the data.
    zoom.to(low, Math.min(last, low + 2 * half))
    mark()
    return speak(`Zoomed: ${counted(inside, 'point')}.`)
  }
  function far() {
    const was = zoom.whole()
    mark()
    if (was) speak('The whole chart is shown.')
    return was
  }
  function toggle(u, k) {
    if (!u.series[k]) return false
    u.setSeries(k, { show: !u.series[k].show })
    mark()
    return speak(`${u.series[k].label} is ${u.series[k].show ? 'shown' : 'hidden'}.`)
  }

  const MOVES = {
    ArrowRight: u => seek(u, index + 1, 1),
    ArrowLeft: u => seek(u, index - 1, -1),
    PageDown: u => seek(u, Math.min(u.data[0].length - 1, index + Math.ceil(points(u).length / TURN)), 1) ?? seek(u, u.data[0].length - 1, -1),
    PageUp: u => seek(u, Math.max(0, index - Math.ceil(points(u).length / TURN)), -1) ?? seek(u, 0, 1),
    Home: u => points(u)[0] ?? null,
    End: u => points(u).at(-1) ?? null,
  }
  const ACTS = { '+': u => closer(u, 0.5), '=': u => closer(u, 0.5), '-': u => closer(u, 2), _: u => closer(u, 2) }
  function act({ key }) {
    const u = plot()
    if (!u) return false
    if (MOVES[key]) return index == null ? start(u) : go(u, MOVES[key](u))
    if (ACTS[key]) return ACTS[key](u)
    if (/^[1-9]$/.test(key)) return toggle(u, Number(key))
    if (key === 'Enter' && onenter && kept != null) return Promise.resolve(onenter(kept)).then(found => found && speak(found))
    return key === 'Escape' ? far() : false
  }
  function end() {
    index = null
    say(at, '')
    plot()?.setCursor({ left: -10, top: -10 })
  }
  byKeys(holder, 'chart', 'On a chart', { begin: () => plot() && start(plot()), act, end })
  return {
    refresh() {
      const u = plot()
      if (index == null || !u) return
      const all = u.data[0]
      if (!all.length) index = null
      else index = all.reduce((a, v, i) => (Math.abs(v - kept) < Math.abs(all[a] - kept) && has(u, i) ? i : a), seek(u, 0, 1) ?? 0)
      mark()
    },
  }
}
