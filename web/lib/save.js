// Files of the service and lines to copy: a link where no key is needed, else a request with it.

import { ask, hasKey } from './api.js'
import { copyButton } from './copybutton.js'
import { download, el, say } from './dom.js'
import { bytes } from './format.js'

/** Makes a link that saves a file of the API; with a key it is read through a request, which a link cannot carry. */
export function save(words, path, name) {
  const node = el('a', { href: path, download: name }, words)
  node.addEventListener('click', async event => {
    if (!hasKey()) return
    event.preventDefault()
    const before = node.textContent
    say(node, `${before}: reading …`)
    try {
      const response = await ask(path, { accept: '*/*', wait: 0 }),
        parts = []
      let size = 0
      for (const reader = response.body.getReader(); ;) {
        const { done, value } = await reader.read()
        if (done) break
        parts.push(value)
        size += value.length
        say(node, `${before}: ${bytes(size)}`)
      }
      download(name, new Blob(parts))
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
