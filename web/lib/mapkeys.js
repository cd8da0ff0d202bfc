// A drawn map by keyboard: arrows go from place to place, or freely where there are no places. In mm, as the map.

import { byKeys, speak } from './speak.js'

const STEP_MM = 10
const FINE_MM = 1
// y grows upwards on the skin.
const WAYS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }

/** The nearest place in a direction: sideways counts double, and at most 45 degrees from it. */
function towards(places, [x, y], [right, up]) {
  let best = null
  let least = Infinity
  for (const place of places) {
    const [dx, dy] = [place[0] - x, place[1] - y]
    const along = dx * right + dy * up
    const aside = Math.abs(dx * up) + Math.abs(dy * right)
    if (along <= 0 || aside > along || along + 2 * aside >= least) continue
    least = along + 2 * aside
    best = place
  }
  return best
}

/**
 * Makes a canvas readable by keys. `spots()` are the places [x, y] in their order, empty where any position may be read;
 * `extent()` is [width, height]. `show(mm)` marks a position, or none with null, and returns its words. `pick(mm)` chooses
 * it. `turn(step)`, if given, goes one thing on or back instead of one place. Both may return words.
 */
export function mapKeys(canvas, { spots, extent, show, pick, turn }) {
  let at = null
  const go = to => {
    at = to ?? at
    speak(show(at))
  }
  const begin = () => {
    const [width, height] = extent()
    const places = spots()
    if (!width) return
    // A place of a map that has other places now is none.
    const known = at && (!places.length || places.some(([x, y]) => x === at[0] && y === at[1]))
    go(known ? at : places[0] ?? [width / 2, height / 2])
  }
  function step(way, fine) {
    const places = spots()
    if (places.length) return go(towards(places, at, way))
    const by = fine ? FINE_MM : STEP_MM
    return go(at.map((mm, axis) => Math.max(0, Math.min(extent()[axis], mm + by * way[axis]))))
  }
  function nth(places, by) {
    const i = places.findIndex(([x, y]) => x === at[0] && y === at[1])
    go(places[Math.max(0, Math.min(places.length - 1, i + by))])
  }
  function act({ key, shiftKey }) {
    if (!extent()[0]) return false
    const places = spots()
    const by = { PageDown: 1, PageUp: -1 }[key]
    if (by && turn) return speak(turn(by) ?? '')
    if (!WAYS[key] && !(places.length && (by || ['Home', 'End'].includes(key))) && !(pick && ['Enter', ' '].includes(key))) return false
    if (!at) return begin()
    if (WAYS[key]) return step(WAYS[key], shiftKey)
    if (by) return nth(places, by)
    if (key === 'Home' || key === 'End') return go(places.at(key === 'Home' ? 0 : -1))
    return speak(pick(at) ?? 'Chosen.')
  }
  byKeys(canvas, 'map', 'On a skin', { begin, act, end: () => show(null) })
}
