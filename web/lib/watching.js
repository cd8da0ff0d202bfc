// What may suspend a run: each monitor with its value, its threshold, and since when it is beyond.

import { el, fill } from './dom.js'
import { capital, moment } from './format.js'
import { watched, watchedValue } from './verdicts.js'

const HEADS = ['Watches', 'Value', 'Threshold', 'Beyond since']

/** Makes the table; `show(rows)` takes `suspenders` of the status, undefined while they are not reported. */
export function watching() {
  const node = el('div')
  let shown = ''
  const row = one => {
    const since = !one.since ? 'no' : `${moment(one.since)}${one.suspends ? '' : ', only warns'}`
    const cells = [watchedValue(one.value, one.unit), watchedValue(one.threshold, one.unit), since].map(text => el('td', {}, text))
    return el('tr', { className: !one.since ? '' : one.suspends ? 'bad' : 'warn' }, el('th', { scope: 'row' }, capital(watched(one.name))), cells)
  }
  return {
    node,
    show(rows) {
      const text = JSON.stringify(rows ?? null)
      if (text === shown) return
      shown = text
      if (!rows?.length) { fill(node, rows && el('p', { className: 'soft small' }, 'No run is watched now.')); return }
      const head = el('thead', {}, el('tr', {}, HEADS.map(words => el('th', { scope: 'col' }, words))))
      fill(node, el('div', { className: 'table' }, el('table', {}, el('caption', {}, 'What may suspend the run'), head, el('tbody', {}, rows.map(row)))))
    },
  }
}
