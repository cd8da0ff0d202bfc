// The tour of a run on the skin: what is done, failed, skipped, now and next, coloured by progress, force or FVU.
// What does not change between two readings of the progress is kept as a bitmap: a redraw costs little
// with 18,000 configurations, since these press few places many times.

import { colour, dark, el, fill } from './dom.js'
import { count, fixed } from './format.js'
import { roundUp, sequential, strip } from './frame.js'
import { disc, line, sharp } from './pen.js'
import { nearest, skin, tips } from './skin.js'

/** What the colours may show. */
export const COLOURINGS = [['progress', 'Progress'], ['force', 'Largest force'], ['fvu', 'Fit of the twins (FVU)']]
const DOT_MM = 7.6, NEAR_MM = 12

/** Places that a tour presses, with the indices of the configurations that press each: { x, y, of }. */
export function places(steps) {
  const known = new Map()
  steps.contacts_mm.forEach((contacts, index) => {
    for (const [x, y] of contacts) {
      const key = `${x},${y}`
      if (!known.has(key)) known.set(key, { x, y, of: [] })
      known.get(key).of.push(index)
    }
  })
  return [...known.values()]
}

/** Makes the map. `set(tour, progress, shape)` shows; `now(index)` marks the present configuration; `colouring(name)`. */
export function tourMap({ signal, label, query, href, onselect = () => {}, forceLimit = () => null }) {
  let steps = null, depths = 1, progress = null, spots = [], kind = 'progress', hovered = null, chosen = null, present = null, ended = false
  let bitmap = null, key = '', edition = 0
  const legend = el('p', { className: 'legend' })
  const total = i => progress?.stored[i] ?? 0
  const values = () => kind === 'force' ? progress?.largest_force_n : progress?.fvu
  const scaleEnd = () => kind === 'force' ? forceLimit() ?? 100 : roundUp(Math.max(0.05, ...quantile(progress?.fvu)))

  const view = skin({ title: 'Tour', signal, label, query, points: true, draw, describe, onhover, onpick, turn, spots: () => spots.map(({ x, y }) => [x, y]) })

  function now() { return present ?? progress?.current ?? null }

  function spotColour(spot, palette, end) {
    if (kind === 'progress') {
      const done = spot.of.reduce((sum, i) => sum + Math.min(1, total(i) / depths), 0) / spot.of.length
      return done > 0 ? { ink: colour('--live'), alpha: 0.25 + 0.75 * done } : null
    }
    let value = null
    for (const i of spot.of) { const v = values()?.[i]; if (v != null && (value == null || v > value)) value = v }
    return value == null ? null : { ink: `rgb(${palette[Math.round(254 * Math.max(0, Math.min(1, value / end)))]})`, alpha: 1 }
  }

  // The part that changes with the progress only.
  function paint(view) {
    bitmap ??= el('canvas')
    const pen = sharp(bitmap, view.width, view.height), palette = kind === 'progress' ? null : sequential(), end = palette && scaleEnd()
    const radius = Math.max(1.5, DOT_MM * view.scale), lost = new Set(progress?.skipped)
    const [grey, bad, skipped] = ['--grey', '--bad', '--skipped'].map(colour)
    for (const spot of spots) {
      const x = view.x(spot.x), y = view.y(spot.y), shade = spotColour(spot, palette, end)
      pen.globalAlpha = shade?.alpha ?? 1
      disc(pen, x, y, radius, shade ? { fill: shade.ink } : { stroke: grey, width: 0.75 })
      pen.globalAlpha = 1
      if (lost.size && spot.of.some(i => lost.has(i))) cross(pen, x, y, 0.7 * radius, skipped)
      else if (spot.of.some(i => progress?.attempts_failed[i])) disc(pen, x, y, radius - 1, { stroke: bad, width: 2 })
    }
  }

  function draw(pen, view, shape) {
    if (!steps) return
    const fresh = `${view.width} ${view.height} ${kind} ${edition} ${dark.matches}`
    if (key !== fresh) { key = fresh; paint(view) }
    pen.drawImage(bitmap, 0, 0, view.width, view.height)
    const size = shape.tip_diameter_mm
    const mark = (index, style) => { if (index != null && steps.contacts_mm[index]) tips(pen, view, steps.contacts_mm[index], size, style) }
    if (!ended && progress?.next !== now()) mark(progress?.next, { stroke: colour('--next'), width: 2.5 })
    if (!ended) mark(now(), { fill: colour('--panel'), stroke: colour('--ink'), width: 3.5 })
    mark(chosen, { stroke: colour('--ink'), width: 2 })
    mark(hovered, { stroke: colour('--ink'), width: 2 })
  }

  // The configuration at a place: the newest done there, else the next one that goes there.
  function near(mm) {
    const { of } = spots[nearest(spots.map(({ x, y }) => [x, y]), mm, NEAR_MM)] ?? {}
    return of ? of.findLast(i => total(i) > 0) ?? of[0] : null
  }

  function words(i) {
    const place = `configuration ${steps.configuration[i]} (${count(i + 1)} of ${count(steps.configuration.length)})`
    const parts = [place, `${count(total(i))} of ${count(depths)} trials`]
    if (progress?.skipped.includes(i)) parts.push('skipped')
    else if (i === now() && !ended) parts.push('now')
    if (progress?.attempts_failed[i]) parts.push(`${progress.attempts_failed[i]} failed attempts`)
    if (progress?.largest_force_n[i] != null) parts.push(`largest force ${fixed(progress.largest_force_n[i], 1, 'N')}`)
    if (progress?.fvu[i] != null) parts.push(`FVU ${fixed(progress.fvu[i], 3)}`)
    return parts.join(', ')
  }

  function onhover(mm) {
    const next = mm && steps ? near(mm) : null
    if (next !== hovered) { hovered = next; view.redraw() }
    return next == null ? '' : words(next)
  }
  function onpick(mm) {
    if (steps) choose(near(mm))
    return at.textContent
  }
  // By key: one configuration of the tour on or back.
  function turn(step) {
    if (!steps) return ''
    choose(Math.max(0, Math.min(steps.configuration.length - 1, (chosen ?? now() ?? 0) + step)))
    return at.textContent
  }

  const at = el('p', { className: 'picked' })
  function choose(index) {
    chosen = index
    onselect(index)
    tell()
    view.redraw()
  }
  function tell() {
    if (chosen == null || !steps?.contacts_mm[chosen]) return fill(at)
    const trials = total(chosen) ? el('a', { href: href(steps.configuration[chosen]) }, 'Show its trials') : 'It has no trials yet.'
    return fill(at, `Chosen: ${words(chosen)}. `, trials)
  }

  function describe() {
    if (!steps) return 'The skin; no tour is known.'
    const done = steps.configuration.filter((_, i) => total(i) >= depths).length
    const told = `${done} of ${steps.configuration.length} configurations done, ${progress?.skipped.length ?? 0} skipped`
    return `The skin with the tour: ${told}.`
  }

  function tellLegend() {
    const entry = (className, text) => el('span', {}, el('i', { className }), text)
    if (!steps) return fill(legend)
    const n = steps.configuration.length, done = steps.configuration.filter((_, i) => total(i) >= depths).length
    const failed = progress?.attempts_failed.filter(Boolean).length ?? 0
    const skipped = progress?.skipped.length ?? 0
    const shared = [
      failed > 0 && entry('ring-bad', `${count(failed)} with failed attempts`), skipped > 0 && entry('dot-skipped', `${count(skipped)} skipped`),
      !ended && entry('ring-now', 'now'), !ended && entry('ring-next', 'next'),
    ]
    if (kind === 'progress') return fill(legend, entry('dot-live', `${count(done)} of ${count(n)} configurations done`), shared)
    const palette = sequential(), bar = strip(i => palette[i]), unit = kind === 'force' ? 'N' : ''
    return fill(legend, el('span', {}, '0'), bar, el('span', {}, fixed(scaleEnd(), unit ? 0 : 2, unit)), shared)
  }

  const changed = () => { edition += 1; tellLegend(); tell(); view.redraw() }
  dark.addEventListener('change', changed, { signal })
  return {
    node: el('div', {}, view.node, legend, at),
    /** Puts a control next to the title. */
    beside(control) { view.node.querySelector('figcaption > span').after(control) },
    set(tour, next, shape, over) {
      if ((tour?.steps ?? null) !== steps) {
        steps = tour?.steps ?? null
        spots = steps ? places(steps) : []
        depths = Math.max(1, tour?.depths_mm.length ?? 1)
        hovered = null
      }
      progress = next
      ended = over
      if (view.shape !== shape && shape) view.geometry(shape)
      changed()
    },
    now(index) { if (index !== present) { present = index; view.redraw() } },
    colouring(name) { if (name !== kind) { kind = name; changed() } },
    choose(index) { if (index !== chosen) { chosen = index; tell(); view.redraw() } },
  }
}

function cross(pen, x, y, r, ink) {
  pen.strokeStyle = ink
  pen.lineWidth = 2.5
  line(pen, [x - r, y - r], [x + r, y + r])
  line(pen, [x + r, y - r], [x - r, y + r])
}

// The 98th percentile, so that one bad trial does not hide the others.
function quantile(values) {
  const known = (values ?? []).filter(v => v != null).sort((a, b) => a - b)
  return known.length ? [known[Math.floor(0.98 * (known.length - 1))]] : []
}
