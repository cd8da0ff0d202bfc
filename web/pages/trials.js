// The trials: "Show me that one." Conditions are in the address; one trial is opened above the list.

import { all, get, withQuery } from '../lib/api.js'
import { around } from '../lib/around.js'
import { button, el, fill, link, note, panel, replacing, sleep } from '../lib/dom.js'
import { clock, count, counted, fixed, moment, plain } from '../lib/format.js'
import { listing } from '../lib/listing.js'
import { BEGUN } from '../lib/runwords.js'
import { shows } from '../lib/save.js'
import { conditions, selection } from '../lib/selection.js'
import { columnsOf, spread } from '../lib/spread.js'
import { table } from '../lib/table.js'
import { trialView, trialWords } from '../lib/trial.js'

const PAGE = 50,
  ROWS_MOST = 1000,
  KEPT = 40,
  TWIN_MS = 3000

/** In the API a run is its uid, its number is scan_id: a link with a number is put right. */
const byNumber = ({ run }) => (/^\d+$/.test(run ?? '') ? { run: null, scan_id: run } : null)

/** Shows the page. */
export async function show(root, { query, signal, set, go }) {
  if (byNumber(query)) return set(byNumber(query))
  let state = query,
    runs = [],
    asked = '',
    open = null,
    looked = ''
  const selecting = replacing(signal),
    showing = replacing(signal)
  // A chart puts its own zoom back: that of an old address would undo the newer one.
  const href = trial => withQuery('/trials', { ...conditions(state), sort: state.sort, scale: state.scale, trial })
  const known = listing('/trials', { words: 'The trials', draw: drawRows, limit: PAGE, most: ROWS_MOST, signal, key: row => row.trial_id })
  const selected = () => ({ sort: '-trial_id', ...conditions(state), ...(state.sort && { sort: state.sort }) })
  const filters = selection({ set, said: known.trouble })
  const charts = spread({ signal, query: () => conditions(state), label: () => (known.items.some(row => row.label === 'virtual') ? 'virtual' : '') })
  const view = trialView({ signal, href, onscale: value => set({ scale: value || null }) })

  // The list.
  const list = table({
    href: row => href(row.trial_id),
    current: row => String(row.trial_id) === state.trial,
    empty: () =>
      Object.keys(conditions(state)).length
        ? 'No trial meets these conditions.'
        : ['No trial is stored yet. Every run stores its trials here: start one in ', link('/queue', 'the queue'), '.'],
    columns: [
      { head: 'Trial', cell: row => count(row.trial_id), left: true },
      { head: 'Run', cell: row => `${row.scan_id} · ${row.experiment}`, left: true },
      { head: 'Configuration', cell: row => count(row.configuration) },
      { head: 'Depth', unit: 'mm', cell: row => fixed(row.depth_mm, 2) },
      { head: 'Tips', cell: row => row.tips },
      { head: 'Contacts', cell: row => row.contact_count },
      { head: 'Largest force', unit: 'N', cell: row => fixed(row.max_force_n, 1) },
      { head: 'FVU', cell: row => fixed(row.fvu, 3) },
      { head: 'RMSE', unit: 'mV', cell: row => (row.rmse_v == null ? null : fixed(row.rmse_v * 1e3, 2)) },
      { head: 'Settled after', unit: 's', cell: row => (row.settle_ms == null ? null : fixed(row.settle_ms / 1e3, 2)) },
      { head: 'Flags', cell: row => (row.flags.length ? el('span', { className: 'warn' }, row.flags.map(plain).join(', ')) : 'none'), left: true },
      { head: 'Measured', cell: row => moment(row.measured_at, true) },
      { head: 'Label', cell: row => row.label, left: true },
    ],
  })
  const told = el('span', { className: 'soft' }),
    again = el('span', { className: 'soft small' })
  const readAgain = button('Read again', () => {
    asked = ''
    reload()
    again.textContent = `Read at ${clock(Date.now())}.` // Often nothing else changes.
  }, { className: 'plain', title: 'Trials may have been stored since' })
  const listPanel = panel('Trials', { aside: told }, list.node, el('div', { className: 'row' }, known.more, readAgain, again))

  function drawRows() {
    const { items, next } = known
    const others = items.length >= ROWS_MOST ? ': narrow the selection to see the others' : ''
    fill(told, items.length > 0 && (next ? `first ${count(items.length)}${others}` : counted(items.length, 'trial')))
    list.show(items)
  }

  async function drawCharts(until) {
    try {
      const { rows, more } = await columnsOf('/trials', selected(), ['trial_id', 'max_force_n', 'contact_count', 'fvu'], { signal: until })
      if (!until.aborted) charts.show(rows, more)
    } catch {
      if (!until.aborted) charts.show([], false)
    }
  }

  /** Marks the open one; the rows themselves stay. */
  function mark() {
    list.node.querySelectorAll('tbody tr').forEach((line, i) => line.classList.toggle('current', String(known.items[i]?.trial_id) === state.trial))
  }

  function reload() {
    const key = JSON.stringify([conditions(state), state.sort])
    if (key === asked) {
      mark()
      return
    }
    asked = key
    known.select(selected())
    drawCharts(selecting())
  }

  // One trial. Read ones are kept, neighbours are read ahead, so that a key answers at once.
  const kept = new Map()
  function read(id) {
    const key = String(id)
    if (!kept.has(key)) {
      const asked = get(`/trials/${key}`, {}, { signal })
      asked.catch(() => kept.delete(key))
      kept.set(key, asked)
      if (kept.size > KEPT) kept.delete(kept.keys().next().value)
    }
    return kept.get(key)
  }
  async function neighbour(id, later) {
    const beyond = `trial_id__${later ? 'gt' : 'lt'}`,
      given = conditions(state),
      free = !('where' in given)
    const page = await get(
      '/trials',
      { ...given, ...(free ? { where: `${beyond}=${id}` } : { [beyond]: id }), sort: later ? 'trial_id' : '-trial_id', limit: 1 },
      { signal }
    )
    return page.items[0]?.trial_id ?? null
  }
  const sides = { earlier: null, later: null }
  const to = id => id != null && set({ trial: id })
  const previous = button('← Previous', () => to(sides.earlier), { title: 'The trial stored before, of this selection. Keys: k, arrow left' })
  const following = button('Next →', () => to(sides.later), { title: 'The trial stored after, of this selection. Keys: j, arrow right' })
  const words = el('p', {}),
    links = el('span', { className: 'row' }),
    name = el('span', {}),
    trouble = el('p', { className: 'bad', role: 'alert', hidden: true })
  const close = button('Close', () => go(href(null)), { className: 'plain' })
  const head = el('section', { className: 'trial-head', 'aria-label': 'Trial' },
    el('div', { className: 'row spread' }, el('h2', { className: 'big' }, name), el('span', { className: 'row' }, previous, following, close)),
    words,
    links,
    trouble
  )
  const detail = el('div', { className: 'trial-detail', hidden: true }, head, view.node)

  /** Reads a trial without a twin again until its twin has come: twins follow their trials. */
  async function followTwin(row, until) {
    while (!row.sim_voltages_v) {
      await sleep(TWIN_MS, until)
      const found = until.aborted || document.hidden ? null : await get(`/trials/${row.trial_id}`, {}, { signal: until }).catch(() => null)
      if (until.aborted) return
      if (!found?.sim_voltages_v) continue
      Object.assign(row, found) // The same object is kept for the next time.
      words.textContent = trialWords(row)
      view.renew()
    }
  }
  async function showTrial() {
    const id = state.trial
    const look = `${id} ${state.scale ?? ''}`
    if (looked === look) return
    looked = look
    const until = showing()
    const first = detail.hidden
    open = id
    detail.hidden = !id
    if (!id) return
    if (first) scrollTo(0, 0)
    name.textContent = `Trial ${id}`
    let row
    try {
      row = await read(id)
    } catch (error) {
      if (open === id && !signal.aborted) {
        looked = '' // It may be tried again.
        note(trouble, `Trial ${id} cannot be shown: ${error.message}`)
        view.node.hidden = true
        fill(words)
        fill(links)
        Object.assign(sides, { earlier: null, later: null })
        previous.disabled = following.disabled = true
      }
      return
    }
    if (open !== id || signal.aborted) return
    note(trouble, '')
    view.node.hidden = false
    words.textContent = trialWords(row)
    fill(links,
      link(`/runs?run=${row.scan_id}`, `Run ${row.scan_id}`),
      link(`/trials?scan_id=${row.scan_id}&configuration=${row.configuration}&sort=trial_id`, 'The same configuration'),
      link(`/model?trial=${id}`, 'In the model'),
      shows('JSON', `/api/v1/trials/${id}`, `trial-${id}.json`)
    )
    const near = Promise.all([neighbour(id, false), neighbour(id, true)]).catch(() => [null, null])
    const context = await around(row, read, { signal }).catch(() => ({}))
    if (open !== id || signal.aborted) return
    view.show(row, context, state.scale ?? '')
    followTwin(row, until)
    ;[sides.earlier, sides.later] = await near
    if (open !== id || signal.aborted) return
    previous.disabled = sides.earlier == null
    following.disabled = sides.later == null
    for (const side of [sides.later, sides.earlier]) if (side != null) read(side).catch(() => {})
  }
  document.addEventListener('keydown', event => {
    if (!state.trial || event.metaKey || event.ctrlKey || event.altKey || event.target.closest?.('input, select, textarea, dialog, [role=slider]')) return
    if (['j', 'ArrowRight'].includes(event.key)) to(sides.later)
    else if (['k', 'ArrowLeft'].includes(event.key)) to(sides.earlier)
    else return
    event.preventDefault()
  }, { signal })

  root.append(detail, filters.node, charts.node, listPanel)
  function update(query) {
    if (byNumber(query)) return set(byNumber(query))
    state = query
    filters.show(state, runs)
    reload()
    showTrial()
  }
  update(query)
  all('/runs', BEGUN, { most: 200, signal }).then(found => {
    runs = found
    filters.show(state, runs)
  }, () => {})
  return { update }
}
