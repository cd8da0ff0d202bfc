// What a plan will take: facts, time by activity, settings, and what prevents it. Used by the queue and the plan.

import { el, facts } from './dom.js'
import { about, bytes, count, counted, fixed, percent, span } from './format.js'
import { table } from './table.js'

const PARTS = {
  settle_s: 'waiting until forces settle',
  press_s: 'pressing',
  other_s: 'storing, wires',
  frames_s: 'taking frames',
  lateral_s: 'driving across',
  radial_s: 'spreading the tips',
  tare_s: 'measuring the zeros',
  reference_s: 'reference presses',
  touch_off_s: 'searching for the surface',
  approach_s: 'lowering',
  raise_s: 'raising',
}
/** Why a caller without the role sees no preflight of a text. */
export const NEEDS_OPERATOR = 'A key with the role operator is needed to check and to queue an experiment.'

const COLOURS = ['--c1', '--c2', '--c3', '--c4', '--c5', '--c6']

/** The band of a duration: "44 s (39 to 65 s)". */
export const band = (likely, low, high) => `${span(likely)} (${span(low)} to ${span(high)})`

/** Metres from millimetres, with a unit that fits. */
const metres = mm => (mm >= 1e6 ? fixed(mm / 1e6, 2, 'km') : mm >= 1000 ? about(mm / 1000, 'm') : fixed(mm, 0, 'mm'))

/** Facts of a preflight. */
export function planFacts(p) {
  return facts([
    ['Trials', count(p.trials)],
    [p.kind === 'real-random' ? 'Placements' : 'Configurations', count(p.configurations)],
    p.distinct_configurations < p.configurations && ['Different ones', count(p.distinct_configurations)],
    ['Likely duration', span(p.duration_s)],
    ['From, to', `${span(p.duration_low_s)} to ${span(p.duration_high_s)}`],
    ['Waits for a person', p.waits_for_person ? counted(p.waits_for_person, 'time') : 'never'],
    p.travel_mm > 0 && ['Travel across', metres(p.travel_mm)],
    p.travel_ratio != null && ['Saved by the order', percent(p.travel_random_order_mm - p.travel_mm, p.travel_random_order_mm)],
    p.reference_presses > 0 && ['Reference presses', count(p.reference_presses)],
    ['Disk', bytes(p.disk_bytes)],
    ['Seed', String(p.seed)],
  ])
}

/** Time by activity: a bar, and every part with its number. */
export function partsBar(parts) {
  const rows = Object.entries(PARTS)
    .map(([key, words]) => ({ words, s: parts[key] ?? 0 }))
    .filter(row => row.s > 0)
    .sort((a, b) => b.s - a.s)
  const whole = rows.reduce((sum, row) => sum + row.s, 0)
  rows.forEach((row, i) => {
    row.colour = `var(${COLOURS[i] ?? '--grey'})`
  })
  const most = rows.slice(0, 3).map(row => `${row.words} ${percent(row.s, whole)}`).join(', ')
  const part = row => el('i', { title: row.words, style: { width: `${(row.s / whole) * 100}%`, background: row.colour } })
  const bar = el('div', { className: 'parts', role: 'img', 'aria-label': `Time by activity: ${most}` }, rows.map(part))
  const mark = row => [el('i', { className: 'dot', style: { background: row.colour } }), row.words]
  const columns = [
    { head: 'Activity', left: true, cell: mark },
    { head: 'Time', cell: row => span(row.s) },
    { head: 'Share', cell: row => percent(row.s, whole) },
  ]
  return el('div', {}, bar, table({ rows, columns, empty: 'Nothing takes time.' }).node)
}

/** The settings of a plan, one row for each number of tips. */
export const settingsTable = p =>
  table({
    rows: p.settings,
    columns: [
      { head: 'Setting', left: true, cell: s => (s.tips == null ? 'weights' : counted(s.tips, 'tip')) },
      { head: 'Trials', cell: s => count(s.trials) },
      { head: 'Duration', cell: s => band(s.duration_s, s.low_s, s.high_s) },
      { head: 'Disk', cell: s => bytes(s.disk_bytes) },
    ],
  }).node

/** What forbids a plan: key, value, limit, and the file in which to change it. */
export function problemList(problems) {
  const line = p =>
    el('li', {},
      el('b', {}, [p.key, p.value].filter(x => x != null && x !== '').join(' = ') || p.file),
      `: ${p.limit}${p.at ? ` (line ${p.at.line})` : ''}`,
      p.key && p.file ? el('span', { className: 'soft' }, ` (${p.file.split('/').at(-1)})`) : '',
    )
  return problems.length ? el('ul', { className: 'problems bad' }, problems.map(line)) : null
}
