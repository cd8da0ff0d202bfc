// Exports: a dataset in a format, written by the service, with progress. Polled while one is under way.

import { once } from './api.js'
import { actor, outcome } from './actions.js'
import { el, every, field, form, panel, select } from './dom.js'
import { keepForm } from './formstate.js'
import { bytes, countOf, listed, moment, percent, plain } from './format.js'
import { listing } from './listing.js'
import { save } from './save.js'
import { table } from './table.js'
import { vocabulary } from './vocabulary.js'
import { TONE, isUnderWay } from './words.js'

/** Format of files by its name. */
const formatOf = name => vocabulary.formats.find(format => format.name === name)

function stateWords({ state, error, rows_done, rows_total }) {
  if (state === 'failed') return `failed: ${error}`
  return state === 'running' ? `${percent(rows_done, rows_total)}, ${countOf(rows_done, rows_total)} rows` : plain(state)
}

/** Makes the panel of the exports; `choose(name)` sets the dataset of the form, whose values are in the address. */
export function exportsPanel({ signal }) {
  const said = outcome(),
    dataset = el('input', { id: 'ex-dataset', required: true, placeholder: 'name or id' })
  const format = select(vocabulary.formats.map(({ name, title }) => [name, title]), 'parquet', () => {}, { id: 'ex-format' }),
    maps = vocabulary.maps.map(({ name, pixel_mm, diameter_mm }) => [name, `${pixel_mm} mm pixels, ${diameter_mm} mm`]),
    map = select([['', 'none'], ...maps], '', () => {}, { id: 'ex-map' })
  const where = el('input', { id: 'ex-where', placeholder: 'split=train, max_force_n__gt=10' }),
    columns = el('input', { id: 'ex-columns', placeholder: 'all' })
  const list = text => text.split(',').map(word => word.trim()).filter(Boolean)
  const asks = actor('Export', said, async () => {
    const body = {
      dataset: dataset.value.trim(),
      format: format.value,
      ...(map.value && { map: map.value }),
      ...(where.value && { where: list(where.value) }),
      ...(columns.value && { columns: list(columns.value) }),
    }
    await once('/exports', body)
    await known.read()
  }, { role: 'viewer', className: 'main', what: 'Export' })
  const state = one => el('span', { className: TONE[one.state] ?? '' }, stateWords(one))
  const what = one =>
    listed([
      formatOf(one.request.format)?.title ?? one.request.format,
      one.request.map && `with force maps ${one.request.map}`,
      one.request.where?.length && `where ${one.request.where.join(' and ')}`,
      one.request.columns?.length && `${one.request.columns.length} columns`,
    ])
  const rows = table({
    empty: 'No export yet. Small datasets need none: they download at once, above.',
    columns: [
      { head: 'Dataset', cell: one => one.request.dataset, left: true },
      { head: 'File', cell: what, left: true },
      { head: 'State', cell: state, left: true },
      { head: 'Size', cell: one => bytes(one.bytes) },
      { head: 'Requested', cell: one => `${moment(one.created_at)} by ${one.asked_by}` },
      { head: 'Last used', cell: one => moment(one.last_used_at) },
      { head: 'Save', cell: one => one.url && save('Save', one.url, `${one.dataset ?? one.request.dataset}.${formatOf(one.request.format)?.extension ?? one.request.format}`) },
    ],
  })
  const known = listing('/exports', { words: 'The exports', draw: () => rows.show(known.items), limit: 20, most: 200, signal })
  known.read()
  every(1500, () => (!known.trouble.hidden || known.items.some(isUnderWay)) && known.read(), signal)
  const node = panel('Exports', { id: 'exports', className: 'live' },
    el('p', { className: 'soft' }, 'A large dataset, a selection or force maps: the service writes the file, also across a restart.'),
    form(() => asks.click(), { className: 'form' },
      field('Dataset', dataset),
      field('Format', format),
      field('Force maps', map),
      field('Conditions', where),
      field('Columns', columns)
    ),
    el('div', { className: 'row' }, asks),
    said.node,
    known.trouble,
    rows.node,
    known.more
  )
  let usual = '' // The dataset that is open, until a person enters another one.
  const write = keepForm([dataset, format, map, where, columns], { usual: control => (control === dataset ? usual : undefined), signal })
  return {
    node,
    /** Offers a dataset; one that a person entered stays, unless this was asked for (`asked`). */
    choose(name, asked = false) {
      const isFree = dataset.value === usual
      usual = asked ? usual : name
      if (!isFree && !asked) return
      dataset.value = name
      write(dataset)
    },
  }
}
