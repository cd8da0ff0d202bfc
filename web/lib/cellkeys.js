// The cells of a picture by keyboard: arrows go from cell to cell. Knows columns and rows, not what they hold.

import { keysHint, speak } from './speak.js'
import { keysOf } from './readkeys.js'

/**
 * Makes a canvas readable by keys. `size()` returns [columns, rows]; `show(cell)` marks the cell [column, row], or none
 * with null, and returns its words.
 */
export function cellKeys(canvas, { size, show }) {
  let cell = null
  canvas.tabIndex = 0
  canvas.setAttribute('role', 'application')
  canvas.setAttribute('aria-roledescription', 'picture of cells')
  canvas.setAttribute('aria-describedby', keysHint('keys-cells', keysOf('On a frame')))
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
    cell = to.map((at, axis) => Math.max(0, Math.min(size()[axis] - 1, at)))
    speak(show(cell))
  }
  canvas.addEventListener('keydown', event => {
    const move = MOVES[event.key]
    if (!move || event.ctrlKey || event.metaKey || event.altKey) return
    event.preventDefault()
    event.stopPropagation() // The page has keys too, as the next trial.
    go(cell ? move(cell) : [0, 0])
  })
  canvas.addEventListener('focus', () => canvas.matches(':focus-visible') && go(cell ?? [0, 0]))
  canvas.addEventListener('blur', () => show(null)) // The cell is kept: the focus comes back to it.
}
