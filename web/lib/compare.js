// Two runs side by side: facts with what differs marked, force over depth, fit, and the keys of their files.

import { contactsTable, fitTable } from './contacts.js'
import { el, fill, link, panel } from './dom.js'
import { counted, listed } from './format.js'
import { medianChart, medians } from './medians.js'
import { facing } from './report.js'
import { runRows } from './runwords.js'
import { table } from './table.js'
import { entries, plainValue } from './toml.js'

const nameOf = run => `Run ${run.scan_id}`

/** Rows of two lists of [name, text] by name: { name, a, b, differs }. */
function sideBySide(one, two) {
  const other = new Map(two)
  const names = [...new Set([...one, ...two].map(([name]) => name))]
  const first = new Map(one)
  return names.map(name => ({ name, a: first.get(name) ?? null, b: other.get(name) ?? null, differs: first.get(name) !== other.get(name) }))
}

function pairTable(rows, a, b, head) {
  const cell = key => row => el('span', { className: row.differs ? 'differs' : '' }, row[key] ?? 'default')
  return table({
    rows,
    empty: 'Nothing differs.',
    current: row => row.differs,
    columns: [
      { head, left: true, cell: row => row.name },
      { head: nameOf(a), cell: cell('a') },
      { head: nameOf(b), cell: cell('b') },
      { head: 'Difference', left: true, cell: row => (row.differs ? 'differs' : '') },
    ],
  }).node
}

/** Makes the comparison of the runs `run` and `with` into `root`. */
export async function compare(root, { run: first, with: second, back, signal }) {
  fill(root, panel('Two runs', {}, el('p', { className: 'soft' }, 'Loading …')))
  const [a, b] = await Promise.all([facing(first, signal), facing(second, signal)])
  if (signal.aborted) return
  const keys = run => entries(run.definition).map(e => [listed([e.table, e.key], '.'), plainValue(e.raw)])
  const facts = sideBySide(runRows(a), runRows(b))
  const changed = sideBySide(keys(a.run), keys(b.run)).filter(row => row.differs)
  const virtual = [a.run, b.run].some(run => run.label === 'virtual')
  const forces = el('section', {}, el('p', { className: 'soft' }, 'Reading the forces …'))
  const who = run => link(`/runs?run=${run.scan_id}`, `${nameOf(run)}, ${run.experiment}`)
  fill(root,
    el('section', {},
      el('h2', {}, el('span', {}, who(a.run), ' and ', who(b.run)), link(back, 'All runs')),
      el('p', {},
        `${counted(facts.filter(row => row.differs).length, 'fact')} differ.`,
        virtual ? el('span', { className: 'badge inline-badge' }, 'virtual') : '',
      ),
    ),
    el('div', { className: 'columns two' },
      panel('Facts', {}, pairTable(facts, a.run, b.run, 'Fact')),
      el('div', { className: 'column' },
        forces,
        panel('Fit of the twins', {},
          fitTable([{ name: nameOf(a.run), fit: a.fit }, { name: nameOf(b.run), fit: b.fit }]),
        ),
        panel('Keys of the experiment files that differ', {}, pairTable(changed, a.run, b.run, 'Key')),
      ),
    ),
    panel('Contacts', {}, contactsTable([a, b].map(({ run, summary }) => ({ name: nameOf(run), kind: run.kind, counts: summary.contact_counts })))),
  )
  const found = await Promise.all([a, b].map(({ run }) => medians(run, signal).catch(() => null)))
  if (signal.aborted) return
  const view = medianChart(
    found.map((tips, i) => ({ name: nameOf([a, b][i].run), tips: tips ?? new Map(), dash: i ? [6, 4] : undefined })),
    { label: () => [...new Set([a, b].map(({ run }) => run.label))].join(' and '), signal },
  )
  const unread = [a, b].filter((_, i) => !found[i]).map(({ run }) => nameOf(run))
  const lacks = unread.length ? `The forces of ${unread.join(' and of ')} could not be read.` : ''
  fill(forces,
    view
      ? [view.node, el('p', { className: 'soft small' }, lacks || `${nameOf(b.run)} is dashed.`)]
      : el('p', { className: 'soft' }, lacks || 'Neither run has trials with a depth.'),
  )
}
