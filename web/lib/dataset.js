// One dataset in full: what is in it, whether it is current, how to load it, columns, lineage and card.

import { ask, get, hasKey, once } from './api.js'
import { actor, outcome } from './actions.js'
import { HEADS } from './contacts.js'
import { el, facts, fill, panel } from './dom.js'
import { bytes, count, counted, listed, moment, percent, plain } from './format.js'
import { fold } from './fold.js'
import { lineageWalk } from './lineage.js'
import { markdown } from './markdown.js'
import { opened, openedHead } from './opened.js'
import { copyable, save } from './save.js'
import { table } from './table.js'
import { vocabulary } from './vocabulary.js'

/** Parts of a dataset as text. */
export const partsWords = report =>
  ['train', 'validation', 'test']
    .filter(part => report.parts?.[part] != null)
    .map(part => `${count(report.parts[part])} ${part}`)
    .join(', ') || 'not split'

/** Rows by number of contacts, as in Table I; columns for `table`. */
export const contactColumns = ['None', ...HEADS].map((head, n) => ({ head, cell: item => count(item.report.contact_counts?.[n] ?? 0) }))

function lines(item) {
  const at = `${location.origin}/api/v1/data/${item.name}.parquet`
  const key = hasKey(),
    bearer = '{"Authorization": "Bearer " + os.environ["PALPATE_KEY"]}'
  return [
    [
      'pandas',
      key ? `import os, pandas as pd; df = pd.read_parquet("${at}", storage_options=${bearer})` : `import pandas as pd; df = pd.read_parquet("${at}")`,
    ],
    [
      'polars',
      key
        ? `import io, os, polars as pl, urllib.request as r; df = pl.read_parquet(io.BytesIO(r.urlopen(r.Request("${at}", headers=${bearer})).read()))`
        : `import polars as pl; df = pl.scan_parquet("${at}").collect()`,
    ],
    ['palpate (Python)', `from palpate import Palpate; df = Palpate("${location.origin}").dataset("${item.name}").polars()`],
    ['SQL', `palpate query 'SELECT contact_count, COUNT(*) AS n FROM "${item.name}" GROUP BY contact_count'`],
    ['DuckDB', `SELECT contact_count, count(*) FROM read_parquet('${at}') GROUP BY 1`],
    ['curl', `curl -OJ ${key ? '-H "Authorization: Bearer $PALPATE_KEY" ' : ''}${at}`],
  ]
}

function definitionWords({ definition: d }) {
  const words = [
    `Task ${d.task}`,
    d.runs?.length ? `runs ${d.runs.join(', ')}` : 'all ended runs of the task',
    d.label && `only ${d.label}`,
    d.deadband_n != null && `contacts from ${d.deadband_n} N`,
    d.flagged === 'leave-out' ? 'flagged trials excluded' : d.flagged && `flagged trials: ${plain(d.flagged)}`,
    d.untouched === 'leave-out' ? 'untouched excluded' : d.untouched && `untouched: ${plain(d.untouched)}`,
    d.contact_counts?.length && `contacts ${d.contact_counts.join(', ')}`,
    d.where?.length && `where ${d.where.join(' and ')}`,
    d.sim_random?.length && `Sim-Random ${d.sim_random.join(', ')}`,
    d.split?.by &&
      d.split.by !== 'none' &&
      `split by ${d.split.by} ${d.split.ratio.join(':')}, seed ${d.split.seed}${d.split.stratify ? ', stratified' : ''}`,
  ]
  return `${listed(words, '; ')}.`
}

/** Whether a dataset is current; the button `again` is offered if it is not. */
function currentPart({ is_current }, again) {
  if (is_current === true) return el('p', {}, el('span', { className: 'good' }, 'Current.'), ' No trial and no twin was stored since it was made.')
  if (is_current !== false) return el('p', { className: 'soft' }, 'Whether it is current is not known.')
  const words = ' Trials or twins were stored since it was made. This id keeps its rows; making it again gives a new id.'
  return el('div', {}, el('p', {}, el('span', { className: 'warn' }, 'Not current.'), words), el('div', { className: 'row' }, again))
}

/** Makes the view of one dataset; `onmade(item)` after it was made again. */
export function datasetView({ signal, go, onmade, onexport }) {
  let state = {},
    walk = null
  const view = opened({ className: 'dataset', signal, draw: read, back: ['/data', 'All datasets'] })

  async function read(node, wanted, mine) {
    walk = null
    fill(node, el('section', {}, el('p', { className: 'soft' }, `Reading ${wanted} …`)))
    const path = `/datasets/${encodeURIComponent(wanted)}`
    const [item, described, lineage] = await Promise.all([
      get(path, {}, { signal: mine }),
      get(`${path}/datapackage.json`, {}, { signal: mine }),
      get(`${path}/lineage`, {}, { signal: mine }),
    ])
    const card = await ask(`/api/v1${path}/card`, { accept: 'text/markdown', signal: mine }).then(
      answer => answer.text(),
      error => `The card cannot be read: ${error.message}`
    )
    if (!mine.aborted) draw(node, item, described, lineage, card, mine)
  }

  function draw(node, item, described, lineage, card, mine) {
    const said = outcome(),
      { report, label } = item
    const again = actor('Make again', said, async () => {
      const named = item.name
      const made = await once('/datasets', /^run-\d+$/.test(named) || lineageIsNamed(item) ? { name: named } : { definition: item.definition })
      said.tell(made.id === item.id ? 'Made again: the same rows, so the same dataset.' : `Made again: ${made.id} has ${counted(made.rows, 'row')}.`)
      onmade(made)
    }, { what: `Make ${item.name} again` })
    const head = el('section', { 'aria-label': item.name },
      openedHead(item.name, item.id, '/data'),
      el('p', {}, definitionWords(item)),
      currentPart(item, again),
      said.node,
      facts([
        ['Rows', count(item.rows)],
        ['Size', bytes(item.bytes)],
        ['Label', el('span', { className: label === 'virtual' ? 'virtual' : '' }, label ?? 'several')],
        ['Made', moment(item.created_at)],
        ['Last used', item.last_used_at ? moment(item.last_used_at) : 'not known'],
        ['Channels', count(report.channels)],
        ['Licence', described.licenses?.[0].title ?? described.licenses?.[0].name ?? 'not stated'],
      ]),
      el('p', {}, `Parts: ${partsWords(report)}.`)
    )
    const counts = panel('Rows by number of contacts', { aside: el('span', {}, 'as in the paper\u2019s Table I') },
      table({
        columns: [{ head: 'Dataset', cell: one => one.name, left: true }, ...contactColumns, { head: 'Total', cell: one => count(one.rows) }],
        rows: [item],
      }).node,
      excluded(report, item.rows)
    )
    const choose = event => {
      event.preventDefault()
      onexport(item.name)
    }
    const files = panel('Load it', {},
      el('div', { className: 'chips downloads' },
        vocabulary.formats.map(({ title, extension }) => save(title, `/api/v1/data/${item.id}.${extension}`, `${item.id}.${extension}`)),
        el('a', { href: '#exports', onclick: choose }, 'With force maps or a selection')
      ),
      lines(item).map(([words, text]) => copyable(words, text)),
      copyable('Cite', described.citation),
      el('p', { className: 'soft small' },
        hasKey() ? 'The lines read the key from PALPATE_KEY; DuckDB takes it by CREATE SECRET (TYPE http, BEARER_TOKEN …). ' : '',
        `The name stands for the newest dataset made with it; ${item.id} always refers to these rows.`
      )
    )
    const meanings = new Map(described.resources[0].schema.fields.map(field => [field.name, field.description]))
    const heads = table({
      columns: [
        { head: 'Column', cell: one => el('code', {}, one.name), left: true },
        { head: 'Type', cell: one => one.type, left: true },
        { head: 'Unit', cell: one => one.unit ?? '', left: true },
        { head: 'In conditions', cell: one => (one.filterable ? 'yes' : 'no'), left: true },
        { head: 'Meaning', cell: one => meanings.get(one.name), left: true },
      ],
      rows: report.columns,
    }).node
    heads.classList.add('tall-table')
    const columns = panel('Columns', { aside: el('span', {}, counted(report.columns.length, 'column')) }, heads)
    walk = lineageWalk({ dataset: item, lineage: lineage.lineage, nets: lineage.trained, signal: mine, set: go })
    const graph = panel('What it was made from', { aside: el('span', {}, 'dataset, runs, trials, frame') }, walk.node)
    const saved = el('span', { className: 'row' },
      save('Save as Markdown', `/api/v1/datasets/${item.id}/card`, `${item.id}.md`),
      save('Save as Data Package', `/api/v1/datasets/${item.id}/datapackage.json`, 'datapackage.json')
    )
    const about = panel('Card', { aside: saved }, fold('card', 'Read the card', { signal: mine }, markdown(card)))
    fill(node, head, counts, el('div', { className: 'columns two' }, files, columns), graph, about)
    walk.show(state)
  }
  return {
    node: view.node,
    show(query) {
      state = query
      if (!query.dataset) walk = null
      view.show(query.dataset)
      walk?.show(query)
    },
    forget: view.forget,
  }
}

/** Whether the name alone makes it: a built-in definition, without what a separate file would add. */
const lineageIsNamed = ({ definition: d }) => !d.runs?.length && !d.where?.length && !d.contact_counts?.length && !d.label

function excluded(report, rows) {
  const out = Object.entries(report.left_out ?? {}),
    whole = rows + out.reduce((sum, [, n]) => sum + n, 0)
  const each = out.map(([why, n]) => `${count(n)} ${plain(why)} (${percent(n, whole)})`).join(', ')
  return el('p', { className: 'soft' }, each ? `Excluded: ${each}.` : 'No trial was excluded.')
}
