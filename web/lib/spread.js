// How a selection of trials is spread: largest force, contacts, and FVU over force. Bounded to MOST rows.

import { ask, rowsOf, withQuery } from './api.js'
import { chart } from './chart.js'
import { el, note, pane } from './dom.js'
import { counted } from './format.js'

/** Largest number of rows that are drawn. */
const MOST = 2000
const COUNTS = [0, 1, 2, 3, 4, 5, 6],
  COLOUR = n => (n === 0 ? '--grey' : `--c${n}`)
// Room for half a bar at both ends.
const wide = (x, y, step) => [[x[0] - 0.8 * step, ...x, x.at(-1) + 0.8 * step], [null, ...y, null]]
const words = n => (n === 0 ? 'no contact' : counted(n, 'contact'))

/** Reads columns of the first rows of a list of the API as NDJSON, page by page; resolves to { rows, more }. */
export async function columnsOf(path, query, columns, { signal }) {
  const rows = []
  for (let at = withQuery(`/api/v1${path}`, { ...query, columns: columns.join(), format: 'ndjson', limit: 1000 }); at;) {
    const response = await ask(at, { accept: 'application/x-ndjson', signal, wait: 20_000 })
    rows.push(...await rowsOf(response))
    at = /<([^>]+)>;\s*rel="?next"?/.exec(response.headers.get('link') ?? '')?.[1]
    if (rows.length >= MOST) return { rows: rows.slice(0, MOST), more: Boolean(at) }
  }
  return { rows, more: false }
}

/** Makes the three charts; `show(rows, more)` draws them. `query()` are the conditions: the service groups all that meet them. */
export function spread({ signal, label, query }) {
  const groups = by => () => withQuery('/api/v1/trials/groups', { ...query(), ...by })
  const common = { time: false, height: 190, signal, label }
  const bars = { ...common, y: 'Trials', series: [{ name: 'trials', digits: 0, bars: true, fill: true, colour: '--c1' }] }
  const force = chart({
    ...bars,
    title: 'Largest force of a trial',
    key: 'largest',
    query: groups({ bin: 'max_force_n:2' }),
    x: 'Largest force',
    xUnit: 'N',
  })
  const contacts = chart({
    ...bars,
    title: 'Contacts of a trial',
    key: 'contacts',
    query: groups({ group_by: 'contact_count' }),
    whole: true,
    x: 'Contacts',
  })
  const fit = chart({
    ...common,
    title: 'FVU over largest force',
    key: 'fvu',
    query: () => withQuery('/api/v1/trials', { ...query(), columns: 'trial_id,max_force_n,contact_count,fvu', format: 'csv', limit: MOST }),
    x: 'Largest force',
    xUnit: 'N',
    y: 'FVU',
    series: COUNTS.map(n => ({ name: words(n), digits: 3, points: true, line: false, colour: COLOUR(n) })),
    range: (low, high) => [0, Math.min(1.5, (high ?? 1) * 1.05 || 1)],
  })
  const said = el('p', { className: 'soft small' })
  const node = el('div', { className: 'columns three' }, pane(force.node, said), pane(contacts.node), pane(fit.node))
  return {
    node,
    show(rows, more) {
      node.hidden = rows.length === 0
      note(
        said,
        rows.length ? `${counted(rows.length, 'trial')} drawn${more ? ', the first of the selection in its order; the rest is not drawn' : ''}.` : ''
      )
      const forces = rows.map(row => row.max_force_n).filter(v => v != null)
      const step = forces.length && Math.max(...forces) > 40 ? 5 : 2,
        bins = new Map()
      for (const v of forces) {
        const bin = Math.floor(Math.max(0, v) / step)
        bins.set(bin, (bins.get(bin) ?? 0) + 1)
      }
      const last = Math.max(0, ...bins.keys()),
        all = Array.from({ length: last + 1 }, (_, i) => i)
      force.set(wide(all.map(i => (i + 0.5) * step), all.map(i => bins.get(i) ?? 0), step))
      contacts.set(wide(COUNTS, COUNTS.map(n => rows.filter(row => row.contact_count === n).length), 1))
      const dots = rows.filter(row => row.max_force_n != null && row.fvu != null).sort((a, b) => a.max_force_n - b.max_force_n)
      fit.set([dots.map(row => row.max_force_n), ...COUNTS.map(n => dots.map(row => (row.contact_count === n ? row.fvu : null)))])
    },
  }
}
