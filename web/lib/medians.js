// Force over depth: the median of the largest force at each depth, for each number of tips.

import { chart } from './chart.js'
import { counted } from './format.js'
import { median } from './runwords.js'
import { columnsOf } from './spread.js'

const MOST = 6000

/** Medians of the first trials of a run: { tips: Map(n -> Map(depth -> N)), trials, more }. */
export async function medians(run, signal) {
  const { rows, more } = await columnsOf(`/runs/${run.uid}/trials`, {}, ['depth_mm', 'max_force_n', 'tips'], { most: MOST, signal })
  const groups = new Map()
  for (const { tips, depth_mm, max_force_n } of rows) {
    if (depth_mm == null || max_force_n == null) continue
    if (!groups.has(tips)) groups.set(tips, new Map())
    const depths = groups.get(tips)
    if (!depths.has(depth_mm)) depths.set(depth_mm, [])
    depths.get(depth_mm).push(max_force_n)
  }
  const one = depths => new Map([...depths].sort(([a], [b]) => a - b).map(([depth, forces]) => [depth, median(forces)]))
  return { tips: new Map([...groups].sort(([a], [b]) => a - b).map(([n, depths]) => [n, one(depths)])), trials: rows.length, more }
}

/** What was not read, as words. */
export const partWords = ({ trials, more }) => (more ? `Medians of the first ${counted(trials, 'trial')}.` : '')

/** A chart of the medians of one or two runs: [{ name, tips, dash? }]; null without any. */
export function medianChart(runs, { label, query, signal }) {
  const lines = runs.flatMap(({ name, tips, dash }) =>
    [...tips].map(([n, depths]) => ({
      name: `${name ? `${name}, ` : ''}${counted(n, 'tip')}`,
      depths,
      dash,
      points: true,
      digits: 1,
      colour: `--c${((n - 1) % 6) + 1}`,
    })),
  )
  if (!lines.length) return null
  const x = [...new Set(lines.flatMap(line => [...line.depths.keys()]))].sort((a, b) => a - b)
  const view = chart({
    title: 'Force over depth, medians',
    key: 'medians',
    time: false,
    x: 'Depth',
    xUnit: 'mm',
    y: 'Largest force',
    unit: 'N',
    height: 240,
    series: lines,
    label,
    query,
    signal,
    range: (_, high) => [0, Math.max(1, (high || 1) * 1.08)],
  })
  view.set([x, ...lines.map(line => x.map(depth => line.depths.get(depth) ?? null))])
  return view
}
