// Scores of evaluations as the paper's tables: voltages (Table III), contacts (Table IV). Side by side, and one by contacts.

import { NUMERALS } from './contacts.js'
import { el, facts, link } from './dom.js'
import { NONE, capital, count, counted, fixed, listed, percent } from './format.js'
import { table } from './table.js'
import { raw } from './toml.js'
import { paper } from './vocabulary.js'

const spread = (mean, digits, unit = '') =>
  mean ? `${fixed(mean.mean, digits)}${mean.sd == null ? '' : ` ± ${fixed(mean.sd, digits)}`}${unit && `\u202f${unit}`}` : NONE
const share = mean => (mean ? `${fixed(mean.mean * 100, 0)}` : NONE)
const fit = score => (score ? `${fixed(score.rmse_v, 4)} / ${fixed(score.fvu * 100, 1)}` : NONE)

/** Nets of an evaluation, by name where they are known. */
const nets = (report, models) =>
  report.models?.map(id => models.find(model => model.id === id)?.name ?? id).join(' + ') ||
  report.calibration ||
  (report.scored === 'voltages' ? 'no net: measured as they are' : 'sensor file')
const rows = report => [
  report.part ? `${report.part} of` : 'all of',
  el('a', { href: `/data?dataset=${report.dataset}` }, report.asked ?? report.dataset),
  report.where?.length ? ` where ${report.where.join(' and ')}` : '',
]

/** Rows of what the paper prints: they have a source instead of models, rows and label. */
const printed = (source, about, scores) => ({ paper: `Paper, ${source}`, about, ...scores })
/** Table III: the Transfer-Net that learned 1 to 6 contacts, on its test sets of 1 to 6. */
const transferOfPaper = () => paper.table_iii.at(-1).test
const voltagesOfPaper = () =>
  printed('Table III', 'Transfer-Net that learned I to VI', {
    voltages: { by_contacts: transferOfPaper().map(({ rmse_v, fvu_percent }, i) => ({ contacts: i + 1, rmse_v, fvu: fvu_percent / 100 })), all: null },
  })
const contactsOfPaper = reports => [
  ...[...new Set(reports.map(report => report.map))]
    .flatMap(map => paper.table_iv.filter(one => one.map === map))
    .map(({ map, score }) => printed('Table IV', `Recon-Net alone, simulated voltages, map ${map}`, { contacts: { all: score } })),
  printed('V\u2011D', 'whole pipeline on Real-Unseen', { contacts: { all: paper.real_unseen } }),
]

/** What was scored, as a link to its evaluation. */
function scoredCell(one, models, href) {
  if (one.paper) return one.paper
  if (one.perfectOf) return el('span', { className: 'soft' }, `perfect map ${one.map ?? ''}`)
  return one.job && href ? el('a', { href: href(one.job) }, one.scored === 'voltages' ? nets(one, models) : one.scored) : one.scored
}
function rowsCell(one) {
  if (one.perfectOf || one.paper) return one.about ?? ''
  return el('span', {}, `${count(one.rows)}, `, rows(one).map((part, i) => (i ? [' ', part] : part)))
}

/** Columns that say what was scored. */
const what = (models, href) => [
  { head: 'Scored', left: true, cell: one => scoredCell(one, models, href) },
  { head: 'Nets', left: true, cell: one => (one.paper || one.perfectOf || one.scored === 'voltages' ? '' : nets(one, models)) },
  { head: 'Rows', left: true, cell: rowsCell },
  { head: 'Held out', cell: one => (one.perfectOf || one.paper ? '' : one.held_out === false ? el('span', { className: 'warn' }, 'no') : 'yes') },
  { head: 'Label', left: true, cell: one => (one.perfectOf ? '' : one.paper ? 'measured' : one.label) },
]

/** Metrics of contacts, as in Table IV and beyond it. */
const METRICS = [
  { head: 'Number error', unit: '%', cell: s => spread(s.number_percent, 0) },
  { head: 'Location error', unit: 'mm', cell: s => spread(s.location_mm, 1) },
  {
    head: 'Closest distance',
    unit: 'mm',
    cell: s => (s.closest_mm ? `${spread(s.closest_mm, 1)}${s.closest_mm.n < s.contacts ? ` of ${percent(s.closest_mm.n, s.contacts)}` : ''}` : NONE),
  },
  { head: 'Force error', unit: '%', cell: s => spread(s.force_percent, 0) },
  { head: 'Diameter error', unit: '%', cell: s => spread(s.diameter_percent, 0) },
  { head: 'Right count', unit: '%', cell: s => share(s.exact_rate) },
  { head: 'Ghosts', unit: 'per trial', cell: s => (s.ghosts_per_trial ? fixed(s.ghosts_per_trial.mean, 2) : NONE) },
]

/** Evaluations of voltages side by side, as Table III: RMSE in V / FVU in %, by number of contacts. */
function voltageTable(reports, models, { href, current } = {}) {
  return table({
    current,
    caption: 'Voltages against the simulated ones, as the paper\u2019s Table III: RMSE in V / FVU in %, by number of contacts.',
    rows: [...reports, voltagesOfPaper()],
    columns: [
      ...what(models, href).filter(column => column.head !== 'Nets'),
      ...[1, 2, 3, 4, 5, 6].map(n => ({ head: NUMERALS[n], cell: one => fit(one.voltages.by_contacts.find(score => score.contacts === n)) })),
      { head: 'All', cell: one => fit(one.voltages.all) },
    ],
  }).node
}

/** Evaluations of contacts side by side, as Table IV: mean ± standard deviation; each above its perfect map. */
function contactTable(reports, models, { href, current } = {}) {
  const lines = reports.flatMap(report => [report, ...(report.perfect ? [{ perfectOf: report, contacts: report.perfect, map: report.map }] : [])])
  return table({
    current,
    caption: 'Contacts, as the paper\u2019s Table IV: mean ± standard deviation. Below each its perfect map, which shows the error of the rule alone.',
    rows: [...lines, ...contactsOfPaper(reports)],
    columns: [
      ...what(models, href).filter(column => column.head !== 'Label'),
      ...METRICS.map(metric => ({ ...metric, cell: one => metric.cell(one.contacts.all) })),
      { head: 'Answer after', unit: 'ms', cell: one => (one.latency_ms ? `${fixed(one.latency_ms[0], 1)}` : one.perfectOf || one.paper ? '' : NONE) },
    ],
  }).node
}

// What a net answers for a whole frame: the unit of its error, and what must be small.
const UNITS = { position: 'mm', pattern: 'places', count: 'contacts', force: 'N' }
const cost = ({ error, right }) => (right ? 1 - right.mean : error.mean)
const interval = (mean, scale, digits) =>
  mean ? `${fixed(mean.mean * scale, digits)}${mean.low_95 == null ? '' : ` [${fixed(mean.low_95 * scale, digits)}, ${fixed(mean.high_95 * scale, digits)}]`}` : NONE

/** Name of the net of a recipe: ridge, kernel-ridge, mlp. */
const kindOf = (report, models) => {
  const recipe = models.find(model => model.id === report.models?.[0])?.manifest.recipe
  return recipe ? (raw(recipe, 'training.net', 'kind') ?? '').replace(/"/g, '') : ''
}

/**
 * Evaluations of quantities side by side, one table for the nets that answered the same quantity of the same rows: their
 * error, and how it compares with that of ridge regression, which costs nothing to train.
 */
function quantityTables(reports, models, { href, current } = {}) {
  const sameRows = ({ quantity, dataset, part, where, rows, frames }) => JSON.stringify([quantity.quantity, dataset, part, where, rows, frames])
  return [...new Set(reports.map(sameRows))].map(key => {
    const group = reports.filter(report => sameRows(report) === key)
    const [first] = group
    const ridge = group.find(report => kindOf(report, models) === 'ridge')
    const constant = { constant: true, quantity: { error: { mean: first.quantity.constant_error }, rows: first.quantity.rows } }
    const of = words => one => (one.constant ? '' : words(one))
    return table({
      current,
      caption:
        `${capital(first.quantity.quantity)} on ${first.part ? `${first.part} of ` : ''}${first.asked ?? first.dataset}: error with its 95\u202f% interval. ` +
        'A net must at least beat ridge regression. The last row is one answer for all rows.',
      rows: [...[...group].sort((a, b) => cost(a.quantity) - cost(b.quantity)), constant],
      columns: [
        { head: 'Net', left: true, cell: one => (one.constant ? 'best constant' : one.job && href ? el('a', { href: href(one.job) }, nets(one, models)) : nets(one, models)) },
        { head: 'Kind', left: true, cell: of(one => kindOf(one, models)) },
        { head: 'Rows', cell: one => count(one.quantity.rows) },
        { head: 'Error', unit: UNITS[first.quantity.quantity], cell: one => interval(one.quantity.error, 1, 2) },
        { head: 'Median', cell: of(one => fixed(one.quantity.median_error, 2)) },
        { head: 'Right', unit: '%', cell: of(one => interval(one.quantity.right, 100, 1)) },
        { head: 'Of ridge', cell: of(one => (ridge && cost(ridge.quantity) > 0 ? fixed(cost(one.quantity) / cost(ridge.quantity), 2) : NONE)) },
        { head: 'Held out', cell: of(one => (one.held_out === false ? el('span', { className: 'warn' }, 'no') : 'yes')) },
        { head: 'Label', left: true, cell: of(one => one.label) },
      ],
    }).node
  })
}

/** The tables of evaluations of any kind, side by side. `href(job)` leads to one, `current(report)` marks one. */
export function scoreTables(reports, models, more) {
  const volts = reports.filter(one => one.voltages)
  const touch = reports.filter(one => one.contacts)
  return [
    volts.length ? voltageTable(volts, models, more) : '',
    touch.length ? contactTable(touch, models, more) : '',
    quantityTables(reports.filter(one => one.quantity), models, more),
  ]
}

/** Scores of voltages by number of contacts, next to the paper's. */
const voltageScores = ({ voltages }) =>
  table({
    rows: [...voltages.by_contacts, { ...voltages.all, contacts: 'all' }],
    columns: [
      { head: 'Contacts', left: true, cell: one => NUMERALS[one.contacts] ?? one.contacts },
      { head: 'Trials', cell: one => count(one.trials) },
      { head: 'RMSE', unit: 'mV', cell: one => fixed(one.rmse_v * 1e3, 2) },
      { head: 'FVU', unit: '%', cell: one => fixed(one.fvu * 100, 1) },
      { head: 'Median FVU', unit: '%', cell: one => fixed(one.median_fvu * 100, 1) },
      { head: 'Paper, Table III: RMSE', unit: 'mV', cell: one => fixed(transferOfPaper()[one.contacts - 1]?.rmse_v * 1e3, 0) },
      { head: 'FVU', unit: '%', cell: one => fixed(transferOfPaper()[one.contacts - 1]?.fvu_percent, 1) },
    ],
  }).node

const spacing = ({ from_mm, to_mm }) =>
  `spacing ${to_mm == null ? `from ${from_mm}` : from_mm > 0 ? `${from_mm} to ${to_mm}` : `under ${to_mm}`}\u202fmm`

/** Scores of contacts by their number and their spacing, and those of the perfect map below them. */
function contactScores({ contacts, perfect }) {
  // Reports of older versions have no scores by spacing.
  const lines = (of, map) => [
    ...of.by_contacts.map(one => ({ name: `${one.contacts}${map}`, score: one.score })),
    ...(of.by_spacing ?? []).map(one => ({ name: `${spacing(one)}${map}`, score: one.score })),
    { name: `all${map}`, score: of.all },
  ]
  return table({
    rows: [...lines(contacts, ''), ...(perfect ? lines(perfect, ', perfect map') : [])],
    columns: [
      { head: 'Contacts', left: true, cell: one => one.name },
      { head: 'Trials', cell: one => count(one.score.trials) },
      { head: 'Estimates / true', cell: one => `${count(one.score.estimates)} / ${count(one.score.contacts)}` },
      ...METRICS.map(metric => ({ ...metric, cell: one => metric.cell(one.score) })),
    ],
  }).node
}

/** How often the answers are right, by the probability that they state. */
function reliabilityTable({ ranges, right, any_right }, ghost) {
  const shares = `${interval(right, 100, 0)}\u202f% of all, with alternatives ${interval(any_right, 100, 0)}\u202f%`
  return table({
    caption: `Answers by their probability. Right: the number, and each contact within ${ghost}; ${shares}.`,
    rows: ranges,
    columns: [
      { head: 'Probability', unit: '%', left: true, cell: one => `${fixed(one.from * 100, 0)} to ${fixed(one.to * 100, 0)}` },
      { head: 'Answers', cell: one => count(one.right.n) },
      { head: 'Stated', unit: '%', cell: one => fixed(one.stated * 100, 0) },
      { head: 'Right', unit: '%', cell: one => interval(one.right, 100, 0) },
    ],
  }).node
}

/** One evaluation in full. */
export function reportView(report, models) {
  const { contacts, quantity } = report
  const without = quantity?.left_out > 0 && `${counted(quantity.left_out, 'row')} without this quantity ${quantity.left_out === 1 ? 'has' : 'have'} no score.`
  // Reports without distances were judged by those of the paper's skin.
  const ghost = fixed(report.distances?.ghost_mm ?? 40, 1, 'mm')
  const where = report.where?.length ? `, where ${report.where.join(' and ')}.` : '.'
  return el('div', {},
    el('p', {}, `By ${nets(report, models)}, on `, link(`/data?dataset=${report.dataset}`, report.dataset), where),
    facts([
      ['Scored', report.scored],
      ['Rows', count(report.rows)],
      ['Part', report.part ?? 'all'],
      ['Label', report.label],
      ['Held out', report.held_out === false ? el('span', { className: 'warn' }, 'no') : 'yes'],
      contacts && ['Least peak', fixed(report.threshold_n, 1, 'N')],
      contacts && ['Ghosts beyond', ghost],
      ...[['place', 'place_in_95'], ['force', 'force_in_95']].map(([of, share]) => contacts?.all[share] &&
        [`95\u202f% regions hold the ${of}`, `${interval(contacts.all[share], 100, 0)}\u202f%`]),
      report.place_sd_mm && ['Only known to', fixed(report.place_sd_mm, 0, 'mm')],
      report.latency_ms && ['Answer after', fixed(report.latency_ms[0], 1, 'ms')],
      report.latency_ms && ['99 % after', fixed(report.latency_ms[1], 1, 'ms')],
    ]),
    report.notes?.length > 0 && el('ul', { className: 'warn' }, report.notes.map(words => el('li', {}, words))),
    report.voltages && voltageScores(report),
    contacts && contactScores(report),
    report.reliability && reliabilityTable(report.reliability, ghost),
    quantity && quantityTables([report], models),
    without && el('p', { className: 'soft' }, without),
  )
}

/** The score of a model in a few words. */
export function shortScore(report) {
  const of = `${report.part ?? 'all'}, ${counted(report.rows, 'row')}`
  if (report.voltages)
    return `FVU ${fixed(report.voltages.all.fvu * 100, 1)}\u202f%, median ${fixed(report.voltages.all.median_fvu * 100, 1)}\u202f% (${of})`
  const { quantity } = report
  if (quantity) {
    const error = fixed(quantity.error.mean, 2, UNITS[quantity.quantity])
    return `${quantity.right ? `${fixed(quantity.right.mean * 100, 0, '%')} right` : `error ${error}`} (${of})`
  }
  const all = report.contacts?.all
  return all
    ? listed([
        all.closest_mm && fixed(all.closest_mm.mean, 1, 'mm'),
        all.exact_rate && `${fixed(all.exact_rate.mean * 100, 0, '%')} right count`,
        `(${report.scored}, ${of})`,
      ], ' ')
    : of
}
