// Tables by the number of contacts: trials, as the paper's Table I with the paper's own row, and the fit of the twins.

import { el } from './dom.js'
import { count, fixed } from './format.js'
import { table } from './table.js'
import { paper as printed } from './vocabulary.js'

/** Heads of the paper's Table I, for 1 to 6 contacts. */
export const HEADS = ['Single', 'Double', 'Triple', 'Quadruple', 'Quintuple', 'Sextuple']
/** 1 to 6 contacts as the paper's tables and figures number them. */
export const NUMERALS = ['none', 'I', 'II', 'III', 'IV', 'V', 'VI']
const sum = values => values.reduce((a, b) => a + b, 0)

/** The table: `rows` [{ name, kind, counts (0 to 6 contacts) }]; the paper's row for each kind is added. */
export function contactsTable(rows) {
  const paper = [...new Set(rows.map(row => row.kind))]
    .flatMap(kind => printed.table_i.filter(one => one.kind === kind))
    .map(({ kind, trials }) => ({ name: `Paper, ${kind === 'real-hex' ? 'Real-Hex' : 'Real-Random'}`, counts: [null, ...trials] }))
  return table({
    rows: [...rows, ...paper],
    caption: 'Trials by the number of contacts (paper, Table I). The total excludes trials without contact, in which every force is below the deadband.',
    columns: [
      { head: 'Run', left: true, cell: row => row.name },
      ...HEADS.map((head, i) => ({ head, cell: row => count(row.counts[i + 1]) })),
      { head: 'Total', cell: row => count(sum(row.counts.slice(1))) },
      { head: 'Without contact', cell: row => count(row.counts[0]) },
    ],
  }).node
}

/** FVU and RMSE by contacts (paper, Fig. 7C and 7F) of one or two runs [{ name, fit }]. */
export function fitTable(runs) {
  const known = runs.filter(({ fit }) => fit?.by_contacts.length)
  if (!known.length) return el('p', { className: 'soft' }, 'No trial with contacts has a simulated twin yet.')
  const rows = known.flatMap(({ name, fit }) => fit.by_contacts.map(one => ({ name, ...one }))).sort((a, b) => a.contacts - b.contacts)
  const quartiles = (box, scale, digits) => `${fixed(box.median * scale, digits)} (${fixed(box.q1 * scale, digits)} to ${fixed(box.q3 * scale, digits)})`
  return table({
    rows,
    caption: 'Median, and the middle half',
    columns: [
      { head: 'Contacts', left: true, cell: row => `${row.contacts}${row.name ? `, ${row.name}` : ''}` },
      { head: 'Trials', cell: row => count(row.trials) },
      { head: 'FVU', cell: row => quartiles(row.fvu, 1, 3) },
      { head: 'RMSE', unit: 'mV', cell: row => quartiles(row.rmse_v, 1e3, 1) },
    ],
  }).node
}
