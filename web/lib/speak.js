// What a screen reader says without a change of focus: one polite line for the whole document, not shown.
// For values that a person asks for by a key. What follows live values must not be spoken here.

import { el, say, set } from './dom.js'
import { keysOf } from './readkeys.js'

let line = null

/** Speaks a text once the reader is free; the newest replaces one that waits. */
export function speak(words) {
  if (!line?.isConnected) document.body.append(line = el('p', { id: 'spoken', className: 'unseen', role: 'status' }))
  say(line, words)
}
speak('') // A line that is made together with its text is often not read.

/**
 * Makes a picture readable by keys: `kind` is what it is, `title` that of its keys in the list of all, which a reader hears.
 * `begin()` is called when the keyboard comes to it, `end()` when the focus leaves; `act(event)` does what a key is for, and
 * returns false for one that is for nothing here.
 */
export function byKeys(node, kind, title, { begin, act, end }) {
  const id = title.toLowerCase().replaceAll(' ', '-')
  if (!document.getElementById(id)) document.body.append(el('p', { id, hidden: true }, keysOf(title)))
  node.tabIndex = 0
  set(node, { role: 'application', 'aria-roledescription': kind, 'aria-describedby': id })
  node.addEventListener('keydown', event => {
    if (event.target !== node || event.ctrlKey || event.metaKey || event.altKey || act(event) === false) return
    event.preventDefault()
    event.stopPropagation() // The page has keys too, as the next trial.
  })
  node.addEventListener('focus', () => node.matches(':focus-visible') && begin())
  node.addEventListener('blur', end)
}
