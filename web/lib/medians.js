// Force over depth: the median of the largest force at each depth, for each number of tips.

import { get } from './api.js'
import { chart } from './chart.js'
import { counted } from './format.js'

/** Medians of a run: Map(number of tips -> Map(depth -> N)). */
export async function medians(run, signal) {
  const { items } = await get(`/runs/${run.uid}/forces`, {}, { signal, wait: 20_000 })
  const tips = new Map()
  for (const at of items) {
    if (at.tips == null) continue // Of all trials.
    if (!tips.has(at.tips)) tips.set(at.tips, new Map())
    tips.get(at.tips).set(at.depth_mm, at.median_n)
  }
  return tips
}

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
