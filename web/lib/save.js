// Files and answers of the service, and lines to copy: a link where no key is needed, else a request with it.

import { ask, hasKey } from './api.js'
import { copyButton } from './copybutton.js'
import { download, el, say } from './dom.js'
import { bytes } from './format.js'

/** Makes a link that saves a file of the API; with a key it is read through a request, which a link cannot carry. */
export const save = (words, path, name) => withKey(el('a', { href: path, download: name }, words), () => path, () => name)

/**
 * Makes a link that shows an answer of the API in another tab; with a key it is read through a request and saved as
 * `name`. Both may be functions, which are called at the click.
 */
export function shows(words, path, name) {
  const now = of => typeof of === 'function' ? of() : of
  const node = el('a', { href: typeof path === 'function' ? '#' : path, target: '_blank', rel: 'noopener' }, words)
  node.addEventListener('click', () => { node.href = now(path) })
  return withKey(node, () => now(path), () => now(name))
}

function withKey(node, path, name) {
  node.addEventListener('click', async event => {
    if (!hasKey()) return
    event.preventDefault()
    const before = node.textContent
    say(node, `${before}: reading …`)
    try {
      const response = await ask(path(), { accept: '*/*', wait: 0 }),
        parts = []
      let size = 0
      for (const reader = response.body.getReader(); ;) {
        const { done, value } = await reader.read()
        if (done) break
        parts.push(value)
        size += value.length
        say(node, `${before}: ${bytes(size)}`)
      }
      download(name(), new Blob(parts))
      say(node, before)
    } catch (error) {
      say(node, `${before}: failed (${error.message})`)
    }
  })
  return node
}

/** Makes a text with a button that copies it. */
export function copyable(words, text) {
  const code = el('code', {}, text)
  const copy = copyButton(() => code.textContent, 'Copy', { node: code, 'aria-label': `Copy the line for ${words}` })
  return el('div', { className: 'copyable' }, el('span', { className: 'soft small' }, words), el('pre', { tabIndex: 0 }, code), copy)
}
