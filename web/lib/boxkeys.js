// The boxes of a box plot by keyboard: arrows go from box to box. Knows their number, not what they hold.

import { keysHint, speak } from './speak.js'
import { keysOf } from './readkeys.js'

/**
 * Makes a canvas readable by keys. `count()` is the number of boxes; `show(i)` marks a box, or none with null, and returns
 * its words. `refresh()` of the result is called after the boxes have changed.
 */
export function readByKeys(canvas, { count, show }) {
  let at = null
  canvas.tabIndex = 0
  canvas.setAttribute('role', 'application')
  canvas.setAttribute('aria-roledescription', 'box plot')
  canvas.setAttribute('aria-describedby', keysHint('keys-boxes', keysOf('On a box plot')))
  const MOVES = { ArrowLeft: i => i - 1, ArrowRight: i => i + 1, Home: () => 0, End: () => Infinity }
  const go = to => {
    if (!count()) return speak('No boxes.')
    at = Math.max(0, Math.min(count() - 1, to))
    return speak(show(at))
  }
  canvas.addEventListener('keydown', event => {
    const move = MOVES[event.key]
    if (!move || event.ctrlKey || event.metaKey || event.altKey) return
    event.preventDefault()
    event.stopPropagation() // The page has keys too.
    go(at == null ? 0 : move(at))
  })
  canvas.addEventListener('focus', () => canvas.matches(':focus-visible') && go(at ?? 0))
  canvas.addEventListener('blur', () => show(null)) // The box is kept: the focus comes back to it.
  return {
    refresh() {
      if (at != null && at >= count()) at = null
      show(at != null && document.activeElement === canvas ? at : null)
    },
  }
}
