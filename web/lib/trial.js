// One trial in full: skin with tips and forces, frame next to twin and difference, forces over depth, what was reached.

import { chart } from './chart.js'
import { colour, el, facts, fill, note, panel, pane, select } from './dom.js'
import { NONE, about, capital, count, counted, fixed, moment, plain, span } from './format.js'
import { frame, minus, roundUp } from './frame.js'
import { lettering, line } from './pen.js'
import { shows } from './save.js'
import { sensorOf, skin, tips } from './skin.js'
import { table } from './table.js'
import { meaning } from './vocabulary.js'

const ARMS = [1, 2, 3, 4, 5, 6]
const SCALES = [['', 'this trial'], ['configuration', 'the deepest trial of its configuration']]
const largest = values => (values ?? []).reduce((top, v) => Math.max(top, Math.abs(v ?? 0)), 1e-4)

const armWords = arm => `arm ${arm.arm} at ${fixed(arm.x_mm, 0)}, ${fixed(arm.y_mm, 0, 'mm')}: ${fixed(arm.force_n, 1, 'N')}`

/** The trial as one sentence. */
export function trialWords(row) {
  const place =
    row.kind === 'real-random'
      ? `Placement ${row.configuration + 1}`
      : `Configuration ${row.configuration}, depth ${fixed(row.depth_mm, 2, 'mm')}, ${counted(row.tips, 'tip')}`
  const contacts = row.contact_count ? counted(row.contact_count, 'contact') : 'no contact'
  return `${place}, ${contacts} by its labels, ${row.label}. Run ${row.scan_id}, ${row.experiment}.`
}

/** Number of the raw frames, as a link to them. */
function rawFrames({ kind, frame_count, trial_id }) {
  if (kind === 'imported') return 'none: imported'
  return frame_count ? shows(count(frame_count), `/api/v1/trials/${trial_id}/frames`, `trial-${trial_id}-frames.json`) : 'none'
}

/** The pose that was reached, against its target. */
function posesPart({ kind, target, reached }) {
  if (!target && !reached) {
    const why = kind === 'real-random' ? 'Weights were placed by a person: no axis moved.' : 'No pose was stored with this trial.'
    return el('p', { className: 'soft' }, why)
  }
  return table({
    rows: [['x_mm', 'x'], ['y_mm', 'y'], ['z_mm', 'z'], ['radius_mm', 'Radius']],
    columns: [
      { head: 'Axis', left: true, cell: ([, name]) => name },
      { head: 'Target', unit: 'mm', cell: ([key]) => fixed(target?.[key], 3) },
      { head: 'Reached', unit: 'mm', cell: ([key]) => fixed(reached?.[key], 3) },
      { head: 'Difference', unit: 'mm', cell: ([key]) => (target && reached ? fixed(reached[key] - target[key], 3) : NONE) },
    ],
  }).node
}

/** What looks faulty in a trial. */
function flagsPart({ flags }) {
  const line = flag => el('li', { className: 'warn' }, `${capital(plain(flag))}. `, el('span', { className: 'soft' }, meaning('flags', flag)))
  return flags.length ? el('ul', {}, flags.map(line)) : el('p', {}, 'No flag: nothing in this trial looks faulty.')
}

/** Makes the view of one trial; `show(row, { siblings, untouched, deepest })` draws it. */
export function trialView({ signal, href, onscale }) {
  let row = null,
    context = {},
    diameter = 0 // Known with the geometry, before anything is drawn.
  const label = () => row?.label ?? ''
  const picture = (title, name) => frame({ title, name, signal, label, query: () => `/api/v1/trials/${row.trial_id}` })
  const shown = {
    measured: picture('Measured frame', 'measured'),
    twin: picture('Simulated twin', 'twin'),
    rest: picture('Measured minus twin', 'residual'),
    touch: picture('Measured minus untouched', 'touch'),
  }
  const why = { twin: el('p', { className: 'soft small' }), touch: el('p', { className: 'soft small' }) }
  const scale = select(SCALES, '', onscale, { id: 'trial-scale' })
  const scaleWords = el('span')
  const map = skin({
    title: 'Skin: tips to scale, forces in N',
    signal,
    label,
    query: () => `/api/v1/trials/${row.trial_id}`,
    draw: drawTips,
    describe: () => (row ? `Skin with ${counted(row.arms.length, 'tip')}: ${row.arms.map(armWords).join('; ')}` : 'Skin'),
    data: () => ({ heads: ['arm', 'x_mm', 'y_mm', 'force_n'], rows: (row?.arms ?? []).map(arm => [arm.arm, arm.x_mm, arm.y_mm, arm.force_n]) }),
  })
  const depths = chart({
    title: 'Forces over depth, this configuration',
    key: 'depths',
    x: 'Depth',
    xUnit: 'mm',
    y: 'Force',
    unit: 'N',
    time: false,
    height: 210,
    signal,
    label,
    series: ARMS.map(arm => ({ name: `arm ${arm}`, digits: 1, points: true, colour: `--c${arm}` })),
    marks: markDepth,
    query: () => `/api/v1/trials?scan_id=${row.scan_id}&configuration=${row.configuration}`,
  })
  const steps = el('div', { className: 'chips trial-steps', role: 'navigation', 'aria-label': 'Depths of this configuration' })
  const fit = el('div'),
    quality = el('div'),
    verdict = el('div'),
    poses = el('div')
  const alone = el('p', { className: 'soft' })
  const node = el('div', { className: 'trial' },
    el('div', { className: 'columns two' },
      el('div', { className: 'column' }, pane(map.node), el('section', {}, depths.node, alone, steps)),
      el('section', {},
        el('div', { className: 'pair trial-frames' },
          shown.measured.node,
          el('div', {}, shown.twin.node, why.twin),
          shown.rest.node,
          el('div', {}, shown.touch.node, why.touch)
        ),
        el('p', { className: 'soft small row' }, el('label', { className: 'inline', htmlFor: 'trial-scale' }, 'Colours by ', scale), scaleWords)
      )
    ),
    el('div', { className: 'columns three' },
      panel('Fit and times', {}, fit),
      panel('Reached against target', {}, poses),
      panel('Quality', {}, verdict, quality)
    )
  )

  function drawTips(pen, view) {
    if (!row) return
    for (const { x_mm, y_mm, force_n, arm } of row.arms) {
      const felt = row.contacts.some(contact => Math.hypot(contact.x_mm - x_mm, contact.y_mm - y_mm) < 1),
        ink = view.colour(`--c${arm}`)
      tips(pen, view, [[x_mm, y_mm]], diameter, { fill: felt ? `${ink}55` : undefined, stroke: ink, width: 2 })
      write(pen, view, x_mm, y_mm, fixed(force_n, 1), `arm ${arm}`)
    }
    if (!row.arms.length)
      for (const { x_mm, y_mm, force_n, diameter_mm } of row.contacts) {
        if (x_mm == null) continue
        tips(pen, view, [[x_mm, y_mm]], diameter_mm ?? diameter, { fill: `${view.colour('--c1')}55`, stroke: view.colour('--c1'), width: 2 })
        write(pen, view, x_mm, y_mm, fixed(force_n, 2), '')
      }
  }
  function write(pen, view, x, y, force, arm) {
    // Away from the other tips: these may be close to each other.
    const places = row.arms.length ? row.arms : row.contacts,
      middle = places.reduce((sum, one) => sum + one.x_mm, 0) / places.length
    const px0 = view.x(x),
      gap = (diameter / 2) * view.scale + 5,
      left = px0 > view.width - 70 || (x < middle - 1 && px0 > 70)
    pen.textBaseline = 'middle'
    pen.textAlign = left ? 'right' : 'left'
    pen.font = '600 14px system-ui, sans-serif'
    const px = px0 + (left ? -gap : gap),
      py = view.y(y)
    lettering(pen, force, px, py, view.colour('--ink'), view.colour('--skin'))
    if (!arm || view.width < 340) return
    pen.font = '11px system-ui, sans-serif'
    lettering(pen, arm, px, py + 14, view.colour('--soft'), view.colour('--skin'))
  }
  function markDepth(u) {
    if (row?.depth_mm == null) return
    const at = u.valToPos(row.depth_mm, 'x', true), pen = u.ctx
    pen.save()
    pen.strokeStyle = colour('--ink')
    pen.lineWidth = 2
    pen.setLineDash([6, 4])
    line(pen, [at, u.bbox.top], [at, u.bbox.top + u.bbox.height])
    pen.restore()
  }

  function frames({ untouched, deepest }) {
    const { voltages_v: v, sim_voltages_v: s } = row
    const wide = scale.value ? (deepest ?? row) : row
    const end = roundUp(Math.max(largest(wide.voltages_v), largest(wide.sim_voltages_v)))
    shown.measured.show(v, { scale: end })
    for (const [kind, values] of [
      ['twin', s],
      ['rest', minus(v, s)],
      ['touch', minus(v, untouched?.voltages_v)],
    ]) {
      shown[kind].node.classList.toggle('absent', !values)
      shown[kind].show(values ?? new Array(v.length).fill(null), { scale: end })
    }
    note(why.twin, s ? '' : 'No twin yet: the service simulates it after the trial was stored.')
    note(why.touch, untouched ? untouched.words : 'No untouched frame is known for this trial.')
    note(scaleWords, `All four end at ±${about(end, 'V')}: linear up to 15\u202f% of it, logarithmic beyond.`)
  }

  function curves(siblings) {
    const one = siblings.length < 2
    depths.node.hidden = one
    note(alone, one ? 'This configuration has one trial: there is no curve over depth.' : '')
    const rows = [...siblings].sort((a, b) => a.depth_mm - b.depth_mm)
    depths.set([rows.map(r => r.depth_mm), ...ARMS.map((_, i) => rows.map(r => r.forces_n[i] ?? null))])
    const step = ({ trial_id, depth_mm }) => {
      const current = trial_id === row.trial_id ? 'page' : null
      return el('a', { className: 'chip', href: href(trial_id), title: `trial ${trial_id}`, 'aria-current': current }, fixed(depth_mm, 1))
    }
    fill(steps, !one && [rows.map(step), el('span', { className: 'soft small' }, 'mm')])
  }

  function words() {
    fill(fit,
      facts([
        ['FVU', fixed(row.fvu, 3)],
        ['RMSE', row.rmse_v == null ? NONE : fixed(row.rmse_v * 1e3, 2, 'mV')],
        ['Largest force', fixed(row.max_force_n, 1, 'N')],
        ['Settled after', row.settle_ms == null ? NONE : span(row.settle_ms / 1e3)],
        ['Overshoot', fixed(row.overshoot_n, 2, 'N')],
        ['Attempt', count(row.attempt)],
        ['Measured', moment(row.measured_at, true)],
        row.placed_by && ['Placed by', row.placed_by],
        ['Raw frames', rawFrames(row)],
      ]),
      row.sim_model ? el('p', { className: 'soft small' }, 'Twin by model ', el('code', {}, row.sim_model), '.') : ''
    )
    fill(poses, posesPart(row))
    fill(verdict, flagsPart(row))
    fill(quality,
      facts([
        ['Dropped packets', count(row.dropped_packets)],
        ['Missing channels', count(row.missing_channels)],
        ['Stuck channels', count(row.stuck_channels)],
        ['Saturated channels', count(row.saturated_channels)],
        ['Injection sum, largest', row.injection_sum_v == null ? NONE : fixed(row.injection_sum_v * 1e3, 2, 'mV')],
      ])
    )
  }

  return {
    node,
    /** Draws what the shown trial got since: its twin and the fit of it. */
    renew() {
      words()
      frames(context)
    },
    async show(next, { siblings = [], untouched = null, deepest = null } = {}, by = '') {
      row = next
      context = { untouched, deepest }
      scale.value = by
      words()
      curves(siblings)
      frames(context)
      map.redraw()
      const shape = await sensorOf(row.scan_id).catch(() => null)
      if (signal.aborted || row !== next) return
      if (shape) {
        diameter = shape.tip_diameter_mm
        if (map.shape !== shape) map.geometry(shape)
      }
      map.redraw()
    },
  }
}
