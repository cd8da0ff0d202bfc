// What may suspend a run: each monitor with its value, its threshold, and since when it is beyond.

import { el, renew, say } from './dom.js'
import { bytes, capital, fixed, moment, span } from './format.js'

const HEADS = ['Watches', 'Value', 'Threshold', 'Beyond since']

/** A value of a suspender with its unit. */
function watchedValue(value, unit) {
  if (value == null) return 'not measured'
  if (unit === 'bytes') return bytes(value)
  if (unit === 'ms' && value >= 1000) return span(value / 1e3)
  return fixed(value, unit === '1' ? 3 : Math.abs(value) < 10 ? 1 : 0, unit === '1' ? '' : unit)
}

/** Makes the table; `show(rows)` takes `suspenders` of the status, undefined while they are not reported. */
export function watching() {
  const node = el('div')
  let lines = []
  const tell = (line, one) => {
    const since = !one.since ? 'no' : `${moment(one.since)}${one.suspends ? '' : ', only warns'}`, tone = !one.since ? '' : one.suspends ? 'bad' : 'warn'
    const texts = [watchedValue(one.value, one.unit), watchedValue(one.threshold, one.unit), since]
    texts.forEach((text, i) => say(line.cells[i + 1], text))
    if (line.className !== tone) line.className = tone
  }
  return {
    node,
    show(rows) {
      // New values are set in place; only other monitors make another table.
      renew(node, rows?.map(one => one.name), () => {
        if (!rows?.length) return rows && el('p', { className: 'soft small' }, 'No run is watched now.')
        lines = rows.map(one => el('tr', {}, el('th', { scope: 'row' }, capital(one.title)), el('td'), el('td'), el('td')))
        const head = el('thead', {}, el('tr', {}, HEADS.map(words => el('th', { scope: 'col' }, words))))
        return el('div', { className: 'table' }, el('table', {}, el('caption', {}, 'What may suspend the run'), head, el('tbody', {}, lines)))
      })
      rows?.forEach((one, i) => tell(lines[i], one))
    },
  }
}
