// Queue: what comes next, and when does it end? Runs in their order with predicted times, changed by
// dragging or by buttons; an editor for a new run, a copy, or a change.

import { ask, get, keep } from '../lib/api.js'
import { confirm, only, outcome } from '../lib/actions.js'
import { carriedItem, carriedTable } from '../lib/carried.js'
import { button, el, every, fill, link, panel, replacing } from '../lib/dom.js'
import { editor, isEdited } from '../lib/editor.js'
import { readExperiment, takeDrops } from '../lib/filedrop.js'
import { capital, plain } from '../lib/format.js'
import { live } from '../lib/live.js'
import { waiting } from '../lib/waiting.js'

const EVERY_MS = 5000

/** What is open in the editor, by the address: '' for nothing. */
const wantedOf = ({ edit, copy, add }) => (edit ? `edit ${edit}` : copy ? `copy ${copy}` : add ? `add ${add}` : '')
const titleOf = ({ edit, copy, add }) => (edit ? `Edit run ${edit}` : copy ? `A copy of run ${copy}` : `New run: ${add === 'file' ? 'from a file' : add}`)

/** Shows the page. */
export async function show(root, { query, signal, go }) {
  const said = outcome()
  const list = waiting({ said, go, signal })
  const add = panel('Add an experiment', { id: 'add' })
  const edit = panel('Experiment', { hidden: true, id: 'edit' })
  let file = {}
  root.append(list.node, edit, add)

  async function take(files) {
    try {
      const next = await readExperiment(files)
      const kept = keep('sessionStorage', 'palpate-draft-file')
      const words = 'Its text was changed and is not in the queue. It cannot be restored.'
      if (kept && isEdited(JSON.parse(kept)) && !(await confirm(`Replace ${JSON.parse(kept).file}?`, words, 'Replace'))) return
      if (signal.aborted) return
      file = next
      keep('sessionStorage', 'palpate-draft-file', JSON.stringify(file))
      opened = null
      go('/queue?add=file')
    } catch (error) {
      said.tell(error.message, 'bad')
    }
  }
  takeDrops(root, take, signal)

  // The editor: what it begins with, and what follows it.
  async function drafted({ add, edit, copy }) {
    if (add === 'file') return { name: 'file', ...file }
    if (add) {
      const { name, text, file } = await carriedItem(add)
      return { name, text, file }
    }
    // The tag is read before the text: what is changed later than this text has another one.
    const tag = edit && (await ask('/api/v1/queue', { signal })).headers.get('etag')
    const run = await get(`/runs/${encodeURIComponent(edit ?? copy)}`, {}, { signal })
    if (edit && run.state !== 'queued') throw new Error(`run ${run.scan_id} is ${plain(run.state)}: only a queued run can be edited. Copy it instead`)
    const draft = { text: run.definition, file: `${run.experiment}.toml`, sensor: run.sensor, from: run.scan_id, autoResume: run.auto_resume }
    return edit ? { ...draft, name: `edit-${run.scan_id}`, run, tag, notBefore: run.not_before } : { ...draft, name: `copy-${run.scan_id}` }
  }
  let opened = null
  const opening = replacing(signal)
  async function editing(query) {
    const wanted = wantedOf(query)
    if (wanted === opened) return
    opened = wanted
    const until = opening()
    edit.hidden = !wanted
    if (!wanted) {
      fill(edit)
      return
    }
    const close = () => go('/queue', { replace: true })
    const heading = el('h2', {}, el('span', {}, titleOf(query)), link('/queue', 'Close'))
    try {
      const draft = await drafted(query)
      if (draft.text == null && !keep('sessionStorage', 'palpate-draft-file')) throw new Error('the file is no longer known: choose it again')
      if (until.aborted) return
      const ondone = row => {
        said.tell(query.edit ? `Run ${row.scan_id} is changed: its plan is new, its place is kept.` : `Queued as run ${row.scan_id}.`, 'good')
        close()
        list.refresh()
      }
      fill(edit, heading, editor({ draft, reread: () => drafted(query), ondone, onclose: close, signal: until }).node)
      edit.scrollIntoView({ block: 'start' })
    } catch (error) {
      if (!until.aborted) fill(edit, heading, el('p', { className: 'bad' }, `${capital(error.message)}.`), button('Close', close))
    }
  }

  every(EVERY_MS, list.refresh, signal)
  let seen = ''
  const changed = ({ status }) => {
    const now = `${status.queue_length} ${status.run?.uid} ${status.run?.state}`
    if (now !== seen) list.refresh()
    seen = now
  }
  live.on('status', changed, signal)

  const chooser = el('input', { id: 'file', type: 'file', accept: '.toml', multiple: true, onchange: event => take(event.target.files) })
  const own = el('div', {}, el('label', { htmlFor: 'file' }, 'A file of yours (.toml; its sensor file too, if the program does not carry it)'), chooser)
  const words = 'Choose one, or drop a file anywhere on this page. You see what it takes before it is queued.'
  fill(add,
    el('h2', {}, 'Add an experiment'),
    el('p', { className: 'soft' }, words),
    only('operator', own),
    await carriedTable(item => `/queue?add=${encodeURIComponent(item.name)}`),
  )
  await Promise.all([list.refresh(), editing(query)])
  return { update: editing }
}
