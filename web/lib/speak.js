// What a screen reader says without a change of focus: one polite line for the whole document, not shown.
// For values that a person asks for by a key. What follows live values must not be spoken here.

import { el, say } from './dom.js'

let line = null

/** Speaks a text once the reader is free; the newest replaces one that waits. */
export function speak(words) {
  if (!line?.isConnected) document.body.append(line = el('p', { id: 'spoken', className: 'unseen', role: 'status' }))
  say(line, words)
}
speak('') // A line that is made together with its text is often not read.

/** Makes a node that names keys for a reader, to be named by `aria-describedby`; made once. */
export function keysHint(id, words) {
  if (!document.getElementById(id)) document.body.append(el('p', { id, hidden: true }, words))
  return id
}
