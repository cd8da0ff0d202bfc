// A button that copies a text.

import { button, say } from './dom.js'

/** Makes a button that copies a text and says so. */
export function copyButton(text, words = 'Copy') {
  const one = button(words, async () => {
    const copied = await (navigator.clipboard?.writeText(text()) ?? Promise.reject(new Error('no clipboard'))).then(() => true, () => false)
    say(one, copied ? 'Copied' : 'Select the text and copy it')
    setTimeout(() => say(one, words), 2500)
  })
  return one
}
