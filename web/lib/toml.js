// Experiment files as text: which keys are in it, and one value changed while comments and order stay.
// Not a parser of TOML, that is the service's part: what it cannot read, it leaves as it is. No DOM.

/** Keys of a text with their values as written: [{ table, key, raw, line, from }]; multi-line values are excluded, an empty value is ''. */
export function entries(text) {
  let table = ''
  return text.split('\n').flatMap((words, line) => {
    const head = /^\s*\[([\w.-]+)\]\s*(#.*)?$/.exec(words)
    if (head) {
      table = head[1]
      return []
    }
    const pair = /^(\s*([\w-]+)\s*=\s*)(.*)$/.exec(words)
    const raw = pair && valueOf(pair[3])
    return raw === null ? [] : [{ table, key: pair[2], raw, line, from: pair[1].length }]
  })
}

/** The value at the start of a text, without a comment behind it; null if it does not end there. */
function valueOf(text) {
  let quote = ''
  let open = 0
  let end = text.length
  for (let i = 0; i < text.length; i += 1) {
    const c = text[i]
    if (quote) {
      if (c === '\\' && quote === '"') i += 1
      else if (c === quote) quote = ''
    } else if (c === '"' || c === "'") quote = c
    else if (c === '[' || c === '{') open += 1
    else if (c === ']' || c === '}') open -= 1
    else if (c === '#') {
      end = i
      break
    }
  }
  return quote || open ? null : text.slice(0, end).trim()
}

/** Value of a key as written, or null. */
export const raw = (text, table, key) => entries(text).find(e => e.table === table && e.key === key)?.raw ?? null

/** The text with one key set to a value as written; `null` removes the key. */
export function put(text, table, key, value) {
  const lines = text.split('\n')
  const found = entries(text)
  const one = found.find(e => e.table === table && e.key === key)
  if (one && value === null) lines.splice(one.line, 1)
  else if (one) lines[one.line] = lines[one.line].slice(0, one.from) + value + lines[one.line].slice(one.from + one.raw.length)
  else if (value !== null) insert(lines, table, `${key} = ${value}`, found)
  return lines.join('\n')
}

function insert(lines, table, words, found) {
  const last = found.findLast(e => e.table === table)?.line ?? lines.findIndex(line => line.trim().startsWith(`[${table}]`))
  const first = lines.findIndex(line => /^\s*\[/.test(line))
  if (last >= 0) lines.splice(last + 1, 0, words)
  else if (!table) lines.splice(first < 0 ? lines.length : first, 0, words)
  else lines.splice(lines.at(-1) === '' ? lines.length - 1 : lines.length, 0, '', `[${table}]`, words)
}

/** A value as written, as a person types it: without quotes and brackets. */
export function plainValue(value) {
  if (/^".*"$/.test(value))
    try {
      return JSON.parse(value)
    } catch {
      return value
    }
  return /^\[.*\]$/.test(value) ? value.slice(1, -1).trim() : value.replace(/^'(.*)'$/, '$1')
}

/** What a person typed, as it is written for a kind: 'string', 'array', or a number or truth value. */
export function written(kind, typed) {
  if (kind === 'string') return JSON.stringify(typed)
  return kind === 'array' ? `[${typed.trim()}]` : typed.trim()
}

/** Kind of a value as written. */
export function kindOf(value) {
  if (/^['"]/.test(value)) return 'string'
  if (value.startsWith('[')) return 'array'
  return value === 'true' || value === 'false' ? 'boolean' : 'number'
}
