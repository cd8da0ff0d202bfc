// Reference presses over the runs: the same place and depth each time, so that a change of force is one of skin or cells.

import { get } from './api.js'
import { chart } from './chart.js'
import { el, fill } from './dom.js'
import { counted, fixed } from './format.js'
import { BEGUN } from './runwords.js'

const LIKE = 'Compare equal numbers of tips.'
const RUNS = 12
const EACH = 200
const mean = values => values.reduce((a, b) => a + b, 0) / values.length

/** Makes the section; `show()` reads the newest runs and draws their reference presses. */
export function references({ label, signal }) {
  const node = el('section', { hidden: true })

  async function pressesOf(run) {
    const page = await get(`/runs/${run.uid}/records/references`, { limit: EACH }, { signal }).catch(() => null)
    return (page?.items ?? []).flatMap(one => {
      const forces = one.arms.map(arm => arm.force_n).filter(force => force != null)
      return forces.length ? [{ at: Date.parse(one.at) / 1e3, depth_mm: one.depth_mm, tips: forces.length, force_n: mean(forces) }] : []
    })
  }

  async function show() {
    const { items: chosen } = await get('/runs', { kind: 'real-hex', ...BEGUN, limit: RUNS }, { signal }).catch(() => ({ items: [] }))
    const found = []
    for (const run of chosen) found.push(...(await pressesOf(run)))
    if (signal.aborted || !found.length) return
    // Another depth would look like a change of the skin: only that of the newest press is drawn.
    const depth = found.reduce((newest, one) => (one.at > newest.at ? one : newest)).depth_mm
    const drawn = found.filter(one => one.depth_mm === depth).sort((a, b) => a.at - b.at)
    const tips = [...new Set(drawn.map(one => one.tips))].sort()
    const view = chart({
      title: 'Force at the reference presses, mean of the tips',
      key: 'references',
      y: 'Force',
      unit: 'N',
      height: 190,
      label,
      signal,
      range: (_, high) => [0, Math.max(1, (high || 1) * 1.1)],
      series: tips.map(n => ({ name: counted(n, 'tip'), digits: 2, points: true, line: false, colour: `--c${n}` })),
    })
    fill(node,
      view.node,
      el('p', { className: 'soft small' },
        `${counted(drawn.length, 'press', 'presses')} at a depth of ${fixed(depth, 2, 'mm')}, newest ${counted(chosen.length, 'run')}. ${LIKE}`,
      ),
    )
    node.hidden = false
    view.set([drawn.map(one => one.at), ...tips.map(n => drawn.map(one => (one.tips === n ? one.force_n : null)))])
  }
  return { node, show }
}
