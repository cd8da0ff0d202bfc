// The cells of a picture, or the boxes of a plot, by keyboard: arrows go from one to the next. Knows columns and rows, not
// what they hold.

import { byKeys, speak } from './speak.js'

const UPRIGHT = ['ArrowUp', 'ArrowDown', 'PageUp', 'PageDown'] // Of no use in one row.

/**
 * Makes a canvas readable by keys. `size()` returns [columns, rows]; `show(cell)` marks the cell [column, row], or none
 * with null, and returns its words. `kind` is what the picture is, `keys` the title of its keys in the list of all.
 */
export function cellKeys(canvas, { size, show, kind = 'picture of cells', keys = 'On a frame' }) {
  let cell = null
  const MOVES = {
    ArrowLeft: ([column, row]) => [column - 1, row],
    ArrowRight: ([column, row]) => [column + 1, row],
    ArrowUp: ([column, row]) => [column, row - 1],
    ArrowDown: ([column, row]) => [column, row + 1],
    Home: ([, row]) => [0, row],
    End: ([, row]) => [Infinity, row],
    PageUp: ([column]) => [column, 0],
    PageDown: ([column]) => [column, Infinity],
  }
  const go = to => {
    if (!size()[0]) return speak('Nothing is drawn.')
    cell = to.map((at, axis) => Math.max(0, Math.min(size()[axis] - 1, at)))
    return speak(show(cell))
  }
  function act({ key }) {
    const move = MOVES[key]
    if (!move || (size()[1] === 1 && UPRIGHT.includes(key))) return false
    return go(cell ? move(cell) : [0, 0])
  }
  // The cell is kept: the focus comes back to it.
  byKeys(canvas, kind, keys, { act, begin: () => go(cell ?? [0, 0]), end: () => show(null) })
}
