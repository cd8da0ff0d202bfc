// Forces: six bars that move with every sample, with the limit; force and depth over the last minutes.

import { colour, el, onBeat, say } from './dom.js'
import { NONE, clock, fixed } from './format.js'
import { chart } from './chart.js'
import { live } from './live.js'
import { line } from './pen.js'
import { indexOf, lastAt, samples } from './samples.js'

const ARMS = [0, 1, 2, 3, 4, 5], PEAK_MS = 30_000, BINS = 360, DRAW_MS = 980, SAY_MS = 240, OLD_MS = 5000
const OVER = 1.1 // A bar's end in limits: the rule of app.css draws the limit at 1 / 1.1.
const SHOWN_MM = 6 // The depth is drawn near the surface only: a raised tip would hide it.

/** Makes the bars. A missing cell has a dashed line; the thin mark is the largest force of the last 30 s. */
export function forceBars({ signal }) {
  const rows = ARMS.map(arm => {
    const bar = el('i'), peak = el('u'), text = el('b', {}, '–')
    const track = el('span', { className: 'track limited' }, bar, peak)
    return { bar, peak, text, track, node: el('li', {}, el('span', {}, el('i', { className: `arm arm-${arm + 1}` }), `Arm ${arm + 1}`), track, text) }
  })
  const note = el('p', { className: 'soft small' })
  const node = el('div', {}, el('ul', { className: 'bars' }, rows.map(row => row.node)), note)
  let said = 0, later = 0
  const draw = onBeat(() => {
    const { rig } = live.status ?? {}
    if (!rig) return
    const words = Date.now() - said > SAY_MS
    if (words) said = Date.now()
    else later ||= setTimeout(() => { later = 0; draw() }, SAY_MS) // The last number is that of the bar.
    const limit = rig.force_limit_n, last = samples.length - 1
    const closed = rig.state === 'disconnected', recent = !closed && last >= 0 && Math.abs(Date.now() - samples.arrived_ms) < OLD_MS
    // The status keeps what was read last: with closed wires nothing is measured.
    const forces = recent ? samples.forces_n.map(column => column[last]) : closed ? null : rig.forces_n, begin = recent ? indexOf(samples.at_ms[last] - PEAK_MS) : 0
    rows.forEach(({ bar, peak, text, track }, arm) => {
      const force = Number.isFinite(forces?.[arm]) ? forces[arm] : null, column = samples.forces_n[arm]
      let most = force ?? 0
      if (recent) for (let i = begin; i <= last; i += 1) if (column[i] > most) most = column[i]
      const part = newtons => Math.max(0, Math.min(1, newtons / (OVER * (limit ?? 100))))
      const share = part(force ?? 0)
      bar.style.transform = `scaleX(${share.toFixed(4)})`
      peak.style.transform = `translateX(${(100 * part(most)).toFixed(2)}%)`
      peak.hidden = force == null || most < 1
      const tone = `track limited${force == null ? ' off' : limit != null && force >= limit ? ' bad' : ''}`
      if (track.className !== tone) track.className = tone
      if (words) say(text, force == null ? closed ? NONE : 'no cell' : fixed(force, 1, 'N'))
    })
    say(note, limit == null ? 'This rig has no load cells.' : closed ? 'The wires are closed: no force is measured.'
      : `Red line: limit ${fixed(limit, 0, 'N')} on one cell. Thin mark: largest of the last 30 s.`)
  })
  live.on('status', draw, signal)
  live.on('samples', draw, signal)
  return node
}

/** Makes the chart of the last `minutes`: force of each arm, depth below the surface; redrawn once per second. */
export function forceChart({ signal, height = 150, minutes = 2, label }) {
  const view = chart({
    title: 'Force and depth', key: 'forces', x: 'Time', y: 'Force', unit: 'N', height, signal, label, query: () => `/api/v1/rig/samples?minutes=${Math.min(30, minutes)}`,
    series: [...ARMS.map(arm => ({ name: `arm ${arm + 1}`, digits: 1 })),
      { name: 'depth', unit: 'mm', digits: 2, axis: 'right', colour: '--soft', dash: [3, 3] }],
    range: () => [0, OVER * (live.status?.rig.force_limit_n ?? 100)], right: { range: () => [-SHOWN_MM, SHOWN_MM], label: 'Depth, mm' },
    marks: u => limitLine(u, live.status?.rig.force_limit_n),
  })
  const old = el('p', { className: 'soft small' })
  let drawn = 0, heard = 0
  const draw = onBeat(() => {
    if (!samples.length || document.hidden) return
    drawn = Date.now()
    view.set(columns(minutes, live.status?.rig.surface?.surface_z_mm))
  })
  live.on('samples', () => {
    heard = Date.now()
    if (heard - drawn > DRAW_MS) draw()
  }, signal)
  live.on('status', () => {
    const last = lastAt()
    const words = last ? `No new samples: the last is of ${clock(last)}.` : 'No samples yet: they come while the rig is connected.'
    say(old, Date.now() - heard < OLD_MS ? '' : words)
  }, signal)
  draw()
  return { node: el('div', { className: 'force-chart' }, view.node, old), minutes(next) { minutes = next; draw() } }
}

// The window in at most BINS columns, each with its largest forces and depth: no peak is lost.
function columns(minutes, surface_z_mm) {
  const end = lastAt(), begin = end - 60e3 * minutes, step = 60e3 * minutes / BINS
  const out = Array.from({ length: 8 }, () => [])
  let bin = -1
  most.fill(NaN)
  for (let i = indexOf(begin); i < samples.length; i += 1) {
    const at = Math.floor((samples.at_ms[i] - begin) / step)
    if (at !== bin) {
      // A gap of more than a second is drawn as one.
      const before = samples.at_ms[i - 1], gap = bin >= 0 && samples.at_ms[i] - before > Math.max(1500, 2 * step)
      if (gap) out.forEach((column, k) => column.push(k ? null : (before + 1) / 1e3))
      bin = at
      out.forEach((column, k) => column.push(k === 7 ? undefined : k ? null : samples.at_ms[i] / 1e3)) // Undefined joins, null is a gap.
      most.fill(NaN)
    }
    for (let arm = 0; arm < DEPTH; arm += 1) larger(arm, samples.forces_n[arm][i])
    if (surface_z_mm != null) larger(DEPTH, samples.z_mm[i] - surface_z_mm) // z is not read with every sample.
    if (i + 1 === samples.length || Math.floor((samples.at_ms[i + 1] - begin) / step) !== bin) close(out)
  }
  return out
}

// Largest forces of the present bin, then its largest depth; NaN without any. A column's number is made once a bin.
const DEPTH = 6, most = new Float64Array(DEPTH + 1)
function larger(k, value) { if (value > most[k] || Number.isNaN(most[k])) most[k] = value }
function close(out) {
  const to = out[0].length - 1
  for (let arm = 0; arm < DEPTH; arm += 1) if (!Number.isNaN(most[arm])) out[arm + 1][to] = most[arm]
  if (!Number.isNaN(most[DEPTH])) out[7][to] = most[DEPTH] < -SHOWN_MM ? null : most[DEPTH]
}

/** Draws a limit over a chart, as a red line with its value. */
function limitLine(u, limit) {
  if (limit == null) return
  const y = u.valToPos(limit, 'y', true), { left, width, top, height } = u.bbox
  if (y < top || y > top + height) return
  const pen = u.ctx, ratio = window.devicePixelRatio || 1
  pen.save()
  pen.strokeStyle = colour('--bad')
  pen.setLineDash([])
  pen.lineWidth = ratio
  line(pen, [left, y], [left + width, y])
  pen.restore()
}
