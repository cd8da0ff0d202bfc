// The editor of an experiment: its text, a form for its keys, what the service finds wrong, and what it will take.
// Nothing is queued before a person asks for it.

import { Refused, get, keep, once, readOnce, send } from './api.js'
import { actor, confirm, outcome } from './actions.js'
import { button, el, fill, replacing, sleep } from './dom.js'
import { fields } from './fields.js'
import { live, who } from './live.js'
import { NEEDS_OPERATOR, partsBar, planFacts, problemList } from './preflight.js'
import { tourPart } from './submitted.js'
import { raw } from './toml.js'

const REST_MS = 400
/** JSON schema of an experiment file. */
const schema = readOnce(() => get('/experiments/schema'))

/** Whether a draft differs from the text that it began with. */
export const isEdited = ({ text, of }) => of != null && text !== of

const local = at => (at ? new Date(new Date(at) - new Date(at).getTimezoneOffset() * 6e4).toISOString().slice(0, 16) : '')

/**
 * Makes the editor of `draft` { name, text, file, sensor?, notBefore?, autoResume?, run?, tag? }: a run that is edited,
 * with the entity tag of the queue before its text was read, or none. `reread()` reads the draft again; `ondone(row)`
 * follows what was queued or changed.
 */
export function editor({ draft, reread, ondone, onclose, signal }) {
  const said = outcome()
  const { run } = draft
  const stored = `palpate-draft-${draft.name}`
  const kept = keep('sessionStorage', stored)
  const state = { ...draft, ...(kept && JSON.parse(kept)) }
  // The text of a sensor file belongs to the name that the experiment had with it; another name is one that the program carries.
  state.named ??= raw(state.text, '', 'sensor')
  // The text that the changes began with, kept with them: another person may have changed the run since.
  state.of ??= draft.text ?? state.text
  const sensor = () => (raw(state.text, '', 'sensor') === state.named ? (state.sensor ?? undefined) : undefined)
  const body = () => ({ file: state.file, definition: state.text, sensor: sensor() })
  const forget = () => keep('sessionStorage', stored, '')

  const area = el('textarea', { id: 'definition', spellcheck: false, wrap: 'off', rows: 18, className: 'code', value: state.text })
  const form = fields({
    schema: null,
    onchange: text => {
      area.value = text
      changed(text)
    },
  })
  const begin = () => {
    area.value = draft.text
    state.of = draft.text
    again.hidden = true
    changed(draft.text)
  }
  const again = el('p', { className: 'warn' }, 'Your changes of before are shown. ', run && state.of !== draft.text && 'The run has been changed since. ', button('Begin again', begin, { className: 'plain' }))
  const found = el('div', { className: 'found', 'aria-live': 'polite' })
  const start = el('input', { id: 'not-before', type: 'datetime-local', value: local(state.notBefore), min: local(new Date()) })
  area.addEventListener('input', () => changed(area.value))
  start.addEventListener('change', () => {
    state.notBefore = start.value ? new Date(start.value).toISOString() : null
    remember()
  })
  const remember = () =>
    keep(
      'sessionStorage',
      stored,
      JSON.stringify({ text: state.text, notBefore: state.notBefore, sensor: state.sensor, named: state.named, file: state.file, of: state.of }),
    )

  const asking = replacing(signal)
  // Parts of the newest answer: those that a person has opened are open in the next one.
  let parts = null
  let tour = null
  function changed(text) {
    state.text = text
    remember()
    form.show(text)
    check()
  }
  /** The preflight, after a rest: problems stand next to their keys. */
  async function check() {
    const until = asking()
    if (!live.may('operator'))
      return fill(found, el('p', { className: 'soft' }, NEEDS_OPERATOR))
    await sleep(REST_MS, until)
    if (until.aborted) return undefined
    try {
      const p = await send('/preflight', body(), { signal: until })
      const problems = form.show(state.text, p.problems)
      save.disabled = p.problems.length > 0
      const words = p.problems.length
        ? el('p', { className: 'bad' }, 'This bench cannot run it. Change the values that are marked, or the rig file.')
        : el('p', { className: 'good' }, 'This bench can run it.')
      parts = el('details', { open: parts?.open }, el('summary', {}, 'Time by activity'), partsBar(p.parts))
      tour = tourPart(body(), until, tour?.open)
      return fill(found, words, problemList(problems), planFacts(p), parts, tour)
    } catch (error) {
      if (until.aborted) return undefined
      const errors = error.problem?.errors
      const problems = form.show(state.text, errors ?? [])
      save.disabled = error.status === 422
      return fill(found,
        el('p', { className: 'bad' }, errors ? 'The file is refused: change the values that are marked.' : `Not checked: ${error.message}`),
        problemList(problems),
      )
    }
  }

  async function submit() {
    // What was said when the run was queued stays, unless the text says it.
    const resumes = raw(state.text, 'policy', 'auto_resume') == null ? draft.autoResume : undefined
    const more = { ...body(), who: who(), not_before: state.notBefore ?? undefined, auto_resume: resumes }
    const row = run ? await put(more) : await once('/queue', more)
    forget()
    ondone(row)
  }
  let known = draft
  const contentOf = ({ text, sensor, notBefore, autoResume }) => JSON.stringify([text, sensor, notBefore, autoResume])
  async function put(more, repeats = true) {
    try {
      return await send(`/queue/${run.uid}`, more, { method: 'PUT', headers: known.tag ? { 'if-match': known.tag } : {} })
    } catch (error) {
      if (error.status !== 412) throw error
      // The tag is that of the whole queue: often another run has changed it.
      const before = known
      known = await reread()
      if (repeats && contentOf(known) === contentOf(before)) return put(more, false)
      throw new Refused(412, 'the run has been changed since its text was shown: close and edit it again to see it, or save again to replace it', error.problem)
    }
  }
  async function close() {
    const words = `The text was changed and is not ${run ? 'saved' : 'in the queue'}. It cannot be restored.`
    if (isEdited(state) && !(await confirm('Discard your changes?', words, 'Discard'))) return
    if (signal.aborted) return
    forget()
    onclose()
  }
  const save = actor(run ? 'Save changes' : 'Add to queue', said, submit, { className: 'main' })

  const node = el('div', { className: 'editor' },
    el('div', {},
      el('h3', {}, 'Keys'),
      el('p', { className: 'soft small' }, 'They write into the text. A key that is absent has its default.'),
      form.node,
    ),
    el('div', { className: 'editor-text' },
      again,
      el('label', { htmlFor: 'definition' }, `Text of ${state.file}`),
      area,
      state.sensor
        ? el('p', { className: 'soft small' }, run || draft.from ? 'The sensor file is that of the run.' : 'The sensor file is the one that you chose.')
        : null,
      found,
      el('label', { htmlFor: 'not-before' }, 'Earliest start (optional; the time of this computer)'),
      start,
      el('p', { className: 'soft small' }, 'The run begins at this time or later, once it is armed and started, and when no other run is active.'),
      el('div', { className: 'row' }, save, button('Close', close, { className: 'plain' })),
      said.node,
    ),
  )
  again.hidden = draft.text == null || draft.text === state.text
  form.show(state.text)
  // Without it the form has no limits and no meanings; the text is checked all the same.
  schema().then(known => {
    if (signal.aborted) return
    form.setSchema(known)
    check()
  }, () => {})
  live.addEventListener('caller', check, { signal })
  check()
  return { node }
}
