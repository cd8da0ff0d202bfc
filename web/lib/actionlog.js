// The log of actions: who asked for what, when, and whether it was accepted. Paged by the cursor.

import { el, panel, say } from './dom.js'
import { clock, listed, moment, plain } from './format.js'
import { listing } from './listing.js'
import { table } from './table.js'

const PAGE = 50, MOST = 2000, LONG = 160

// A refused file may be quoted whole: its begin is enough, the rest opens.
const short = words => words.length <= LONG ? words : el('details', {}, el('summary', {}, `${words.slice(0, LONG)} …`), words)

/** Rows in which the same person did the same again and again, as a jog does, become one with a number. */
function joined(items) {
  const rows = [], same = (a, b) => ['who', 'action', 'accepted', 'why', 'detail', 'run'].every(key => a[key] === b[key])
  for (const item of items) {
    if (rows.length && same(rows.at(-1), item)) rows.at(-1).times += 1
    else rows.push({ ...item, times: 1 })
  }
  return rows
}

/** Makes the panel of the log; `run` limits it to a run. */
export function actionLog(signal) {
  let of = null // The run, '' for all; null before the first reading.
  const known = listing('/actions', { words: 'The log', draw: page => page && draw(known), limit: PAGE, most: MOST, signal }), told = el('p', { className: 'soft' })
  const rows = table({
    empty: 'No action yet.',
    columns: [{ head: 'When', cell: one => el('span', { className: 'nowrap', title: one.at },
      `${moment(one.at).replace(/\d\d:\d\d$/, '')}${clock(one.at)}`) }, { head: 'Who', left: true, cell: one => one.who },
      { head: 'Action', left: true, cell: one => `${plain(one.action)}${one.times > 1 ? `, ${one.times} times` : ''}` },
      { head: 'Result', left: true, cell: one => el('span', { className: one.accepted ? '' : 'warn' }, one.accepted ? 'accepted' : 'refused') },
        { head: 'Why', left: true, cell: one => short(listed([one.why, one.detail], '. ')) }],
  })
  const node = panel('Log of actions', {}, known.trouble, rows.node, el('div', { className: 'row' }, known.more, told))
  function load({ run = of ?? '', again = false } = {}) {
    if (!again && run === of) return undefined
    of = run
    return known.select({ run })
  }
  function draw({ items, next }) {
    rows.show(joined(items))
    say(told, listed([next ? `${items.length} actions shown.` : items.length ? 'All are shown.' : '', `Read at ${clock(Date.now())}.`], ' '))
  }
  return { node, load }
}
