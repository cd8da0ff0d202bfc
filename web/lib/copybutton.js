// A button that copies a text.

import { button, say } from './dom.js'

/** Makes a button that copies a text and says so; `node` is marked where the browser forbids it, ready for the keys. */
export function copyButton(text, words = 'Copy', { node, ...props } = {}) {
  const one = button(words, async () => {
    const copied = await (navigator.clipboard?.writeText(text()) ?? Promise.reject(new Error('no clipboard'))).then(() => true, () => false)
    if (!copied && node) getSelection().selectAllChildren(node)
    say(one, copied ? 'Copied' : node ? 'Marked' : 'Select the text and copy it')
    setTimeout(() => say(one, words), 2500)
  }, props)
  return one
}
