// Wear: what needs care? Presses on each place of the skin, travel of the axes, age of the cells' calibration,
// last check, hours. Numbers only: no limits are defined.

import { get } from '../lib/api.js'
import { button, el, facts, fill, link, panel } from '../lib/dom.js'
import { age, clock, count, counted, fixed, moment } from '../lib/format.js'
import { rigLabel } from '../lib/live.js'
import { references } from '../lib/references.js'
import { sensor } from '../lib/skin.js'
import { table } from '../lib/table.js'
import { wearMap } from '../lib/wearmap.js'

function summary(wear) {
  const hours = wear.run_h
  const checked = wear.checked_at
  const list = facts([
    ['Trials', count(wear.trials)],
    ['Runs', count(wear.runs)],
    wear.since && ['Since', moment(wear.since)],
    ['Hours of runs', fixed(hours, hours < 10 ? 2 : 0, 'h')],
    ['Last check', checked ? moment(checked) : 'none stored'],
    checked && ['Days since', count(Math.floor(age(checked) / 86_400))],
  ])
  // One configuration presses a place once, deeper with each of its trials.
  const words =
    'Presses count configurations on this skin; reference presses are not in them. Hours are from begin to end of its ended runs, with their waits. ' +
    `Read at ${clock(Date.now())}.`
  return [list, el('p', { className: 'soft' }, words)]
}

function axes(wear) {
  const columns = [
    { head: 'Axis', left: true, cell: a => a.axis },
    { head: 'Travel', unit: 'm', cell: a => fixed(a.travel_m, 1) },
  ]
  const words = 'A lower bound: the sum over consecutive stored poses. Moves between poses, homing and jogs are not included.'
  return panel('Axes', {}, table({ rows: wear.axes, columns, empty: 'No pose is stored yet.' }).node, el('p', { className: 'soft small said' }, words))
}

function cells(wear) {
  const columns = [
    { head: 'Arm', left: true, cell: c => String(c.arm) },
    { head: 'Calibrated', cell: c => c.calibrated_on ?? 'not stated' },
    { head: 'Age', unit: 'days', cell: c => count(c.age_days) },
  ]
  const unknown = wear.cells.filter(cell => cell.age_days == null).length
  const which = unknown === wear.cells.length ? 'the cells were' : `${counted(unknown, 'cell')} ${unknown === 1 ? 'was' : 'were'}`
  const words = unknown ? el('p', { className: 'soft small said' }, `The rig file does not state when ${which} calibrated (key cells.calibrated_on).`) : null
  // A table without a single date would be a wall of dashes.
  const list = unknown > 0 && unknown === wear.cells.length ? '' : table({ rows: wear.cells, columns, empty: 'This rig has no load cells.' }).node
  return panel('Load cells', {}, list, words)
}

function whatToDo(wear) {
  const check = wear.checked_at
    ? 'Check every device again after any work on the rig: '
    : 'No check of the devices is stored. Do one before the next long run: '
  const lines = [
    [check, link('/rig', 'rig'), '.'],
    ['Look at the skin where it is pressed most: dents, cracks, loose layers. Choose a place in the table to see where it is.'],
    ['Watch the reference presses: less force at the same place and depth, over weeks, is the first sign of a worn skin.'],
    ['Then compare an early run with a late one: ', link('/runs', 'runs'), '.'],
    ['Keep the dates of cell calibrations in the rig file, so that their age is shown here.'],
  ]
  const unknown =
    'How many presses a skin withstands, and how far an axis may travel before it needs grease, is not stored here: see the manufacturers’ manuals.'
  return panel('What to do', {},
    el('ul', { className: 'listed' }, lines.map(line => el('li', {}, line))),
    el('p', { className: 'soft' }, unknown),
  )
}

/** Shows the page. */
export async function show(root, { query, signal, set }) {
  const map = wearMap({ onchoose: (x, y) => set({ x, y }), label: rigLabel, signal })
  const drift = references({ label: rigLabel, signal })
  const top = el('section', {}, el('p', { className: 'soft' }, 'Loading …'))
  const rest = el('div', { className: 'columns three' })
  const middle = el('div', { className: 'columns two', hidden: true }, map.map, el('div', { className: 'column' }, map.most, map.spread))
  root.append(top, middle, drift.node, rest)
  const mark = ({ x, y }) => (x == null ? map.choose(null) : map.choose(Number(x), Number(y)))

  async function read() {
    try {
      const [wear, shape] = await Promise.all([get('/wear', {}, { signal }), sensor().catch(() => null)])
      middle.hidden = false
      map.show(wear.points, shape)
      mark(query)
      fill(top, summary(wear))
      fill(rest, axes(wear), cells(wear), whatToDo(wear))
      await drift.show()
    } catch (error) {
      if (signal.aborted) return
      const words = el('p', { className: 'bad' }, `The wear of this rig could not be read: ${error.message}.`)
      fill(top, words, el('div', { className: 'row' }, button('Try again', read)))
    }
  }
  await read()
  return {
    update(next) {
      query = next
      mark(query)
    },
  }
}
