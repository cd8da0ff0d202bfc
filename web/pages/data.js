// The datasets: "What can I load?" The list as the paper's Table I, one opened above it, exports below.

import { keep, once } from '../lib/api.js'
import { actor, only, outcome } from '../lib/actions.js'
import { el, fill, panel, renew } from '../lib/dom.js'
import { bytes, count, counted, moment } from '../lib/format.js'
import { contactColumns, datasetView, partsWords } from '../lib/dataset.js'
import { exportsPanel } from '../lib/exports.js'
import { fold } from '../lib/fold.js'
import { listing } from '../lib/listing.js'
import { live } from '../lib/live.js'
import { table } from '../lib/table.js'

const ABOUT = {
  real: 'Real-Hex with contacts: measured voltages to force map (Table II)',
  'real-untouched': 'Real-Hex where no tip pressed',
  'r2s-transfer': 'measured to simulated voltages (Table II)',
  's2s-recon': 'simulated voltages to force map (Table II)',
  'real-by-trial': 'real, split by trial as in the paper',
  'r2s-transfer-by-trial': 'r2s-transfer, split by trial as in the paper',
  's2s-recon-by-trial': 's2s-recon, split by trial as in the paper',
  'real-unseen': 'Real-Random: the test with weights (Table II)',
}
const DRAFT = 'palpate-draft-dataset'
const EXAMPLE = 'name = "strong"\ntask = "real"\nwhere = ["max_force_n__gt=20"]\n\n[split]\nratio = [3, 1, 1]\nseed = 1\n'

/** Shows the page. */
export async function show(root, { query, signal, set, go }) {
  const known = listing('/datasets', { words: 'The datasets', draw, limit: 50, signal })
  let items = [],
    names = []
  const said = outcome(),
    files = exportsPanel({ signal }),
    told = el('span')
  const view = datasetView({
    signal,
    go: set,
    onmade: made,
    onexport: name => {
      files.choose(name, true)
      files.node.scrollIntoView({ block: 'start' })
      files.node.querySelector('select').focus()
    },
  })
  const newest = item => items.find(one => one.name === item.name) === item
  const list = table({
    href: item => `/data?dataset=${newest(item) ? item.name : item.id}`,
    current: item => item.id === query.dataset || (item.name === query.dataset && newest(item)),
    empty: () => `No dataset yet. A run gives one when it ends${live.may('operator') ? '; the definitions below make the others' : ''}.`,
    columns: [
      { head: 'Dataset', cell: item => item.name, left: true },
      { head: 'Label', cell: item => item.label, left: true },
      ...contactColumns,
      { head: 'Total', cell: item => count(item.rows) },
      { head: 'Parts', cell: item => partsWords(item.report), left: true },
      { head: 'Size', cell: item => bytes(item.bytes) },
      { head: 'Made', cell: item => el('span', {}, moment(item.created_at), newest(item) ? '' : el('span', { className: 'soft' }, ' (older)')) },
      { head: 'Last used', cell: item => moment(item.last_used_at) },
    ],
  })
  const offered = el('div', { className: 'offers' })

  // Making one: by a name, or by the text of a definition.
  // A text is too long for an address: it is kept in this tab.
  const text = el('textarea', {
    id: 'ds-text',
    rows: 9,
    spellcheck: false,
    value: keep('sessionStorage', DRAFT) || EXAMPLE,
    oninput: () => keep('sessionStorage', DRAFT, text.value),
  })
  const file = el('input', {
    id: 'ds-file',
    type: 'file',
    accept: '.toml',
    onchange: async () => {
      if (!file.files[0]) return
      text.value = await file.files[0].text()
      keep('sessionStorage', DRAFT, text.value)
    },
  })
  const make = (words, body, props) => actor(words, said, async () => made(await once('/datasets', body())), props)
  const own = fold('definition', 'A definition of your own', { signal },
    el('p', { className: 'soft small' },
      'Keys: name, task (trials, real, r2s-transfer, s2s-recon, real-unseen), runs, label, deadband_n, flagged, untouched, ',
      'contact_counts, where, sim_random, license, [split].'
    ),
    el('label', { htmlFor: 'ds-text' }, 'Definition (TOML)'),
    text,
    el('label', { htmlFor: 'ds-file' }, 'or a file'),
    file,
    el('div', { className: 'row' }, make('Make the dataset', () => ({ toml: text.value }), { className: 'main' }))
  )
  const listPanel = panel('Datasets', { aside: told }, known.trouble, list.node, el('div', { className: 'row' }, known.more))
  const makePanel = only('operator', panel('Make one of the trials stored now', {}, offered, own, said.node))
  root.append(view.node, listPanel, makePanel, files.node)

  function made(item) {
    known.read()
    view.forget()
    go(`/data?dataset=${item.name}`, { replace: query.dataset === item.name })
  }
  function draw(page) {
    items = known.items
    names = page?.definitions ?? names
    fill(told, items.length ? `${known.next ? 'first ' : ''}${counted(items.length, 'dataset')}, newest first` : '')
    list.show(items)
    const isThere = name => items.some(item => item.name === name)
    const line = name => {
      const there = isThere(name)
      return el('li', {},
        el('code', {}, name),
        el('span', { className: 'soft' }, ABOUT[name] ?? 'a definition of this service'),
        make(there ? 'Make again' : 'Make', () => ({ name }), { what: `Make ${name}`, 'aria-label': `${there ? 'Make again' : 'Make'}: ${name}` })
      )
    }
    renew(offered, names.map(name => [name, isThere(name)]), () => el('ul', {}, names.map(line)))
  }
  function update(changed) {
    query = changed
    files.choose(query.dataset ?? 'real')
    view.show(query)
    list.show(items)
  }
  live.addEventListener('caller', () => list.show(items), { signal }) // What an empty list says depends on the role.
  files.choose(query.dataset ?? 'real')
  view.show(query)
  await known.read() // The rows move what is below them, as the part of a link to #exports.
  return { update }
}
