// Markdown as elements: headings, paragraphs, lists, tables, code, emphasis and links. No HTML is read.

import { el } from './dom.js'

const INLINE = /(`[^`]+`)|\*\*([^*]+)\*\*|\*([^*\s][^*]*)\*|\[([^\]]+)\]\((https?:\/\/[^)\s]+)\)/g

/** A line with code, emphasis and links as nodes. */
function inline(text) {
  const nodes = []
  let from = 0
  for (const match of text.matchAll(INLINE)) {
    nodes.push(text.slice(from, match.index), marked(match))
    from = match.index + match[0].length
  }
  return [...nodes, text.slice(from)].filter(Boolean)
}

/** The element of a match of `INLINE`. */
function marked([, code, strong, soft, words, href]) {
  if (code) return el('code', {}, code.slice(1, -1))
  if (strong) return el('strong', {}, strong)
  return soft ? el('em', {}, soft) : el('a', { href, target: '_blank', rel: 'noopener' }, words)
}

const cells = line => line.replace(/^\s*\|/, '').replace(/\|\s*$/, '').split('|').map(cell => cell.trim())
const isRow = line => /^\s*\|.*\|\s*$/.test(line ?? ''),
  isRule = line => /^\s*\|[\s:|-]+\|\s*$/.test(line ?? '')
const ITEM = /^\s*([-*]|\d+\.)\s+/

/** Elements of a text in Markdown; its first heading is one of level 3. */
export function markdown(text) {
  const lines = text.split(/\r?\n/),
    nodes = []
  const take = test => {
    const taken = []
    while (i < lines.length && test(lines[i])) taken.push(lines[i++])
    return taken
  }
  let i = 0
  while (i < lines.length) {
    const line = lines[i],
      head = /^(#{1,6})\s+(.*)$/.exec(line)
    if (!line.trim()) i += 1
    else if (head) {
      nodes.push(el(`h${Math.min(6, 2 + head[1].length)}`, {}, inline(head[2])))
      i += 1
    } else if (line.startsWith('```')) {
      i += 1
      nodes.push(el('pre', {}, take(l => !l.startsWith('```')).join('\n')))
      i += 1
    } else if (isRow(line)) nodes.push(rows(take(isRow)))
    else if (ITEM.test(line)) {
      const items = take(l => ITEM.test(l) || /^\s{2,}\S/.test(l)).reduce(
        (found, l) => (ITEM.test(l) ? [...found, l.replace(ITEM, '')] : [...found.slice(0, -1), `${found.at(-1)} ${l.trim()}`]),
        []
      )
      nodes.push(
        el(/^\s*\d/.test(line) ? 'ol' : 'ul', { className: 'listed' },
          items.map(item => el('li', {}, inline(item)))
        )
      )
    } else nodes.push(el('p', {}, inline(take(l => l.trim() && !isRow(l) && !ITEM.test(l) && !/^#{1,6}\s|^```/.test(l)).join(' '))))
  }
  return el('div', { className: 'markdown' }, nodes)
}

function rows(lines) {
  const ruled = isRule(lines[1]),
    body = lines.slice(ruled ? 2 : 0)
  const line = (tag, text) =>
    el('tr', {},
      cells(text).map((cell, i) =>
        el(tag, { ...(tag === 'th' && { scope: 'col' }), className: i === 0 || !/^[\d.,\s]*$/.test(cell) ? 'left' : '' }, inline(cell))
      )
    )
  return el('div', { className: 'table' },
    el('table', {},
      ruled && el('thead', {}, line('th', lines[0])),
      el('tbody', {}, body.map(text => line('td', text)))
    )
  )
}
