// The model: how does the skin behave? Contacts are placed on a drawn skin with the mouse; the model answers
// with voltages, dent and forces. A stored trial can be laid over it, and Fig. 7 of the paper is below,
// and what makes simulations in bulk: twins, and workers on other machines.

import { get, send } from '../lib/api.js'
import { asked, contactList, contactsText, most, parseContacts, within } from '../lib/presslist.js'
import { dent } from '../lib/dent.js'
import { button, el, facts, fill, form, note, pane, panel, renew, replacing, say, select } from '../lib/dom.js'
import { fit, scatter } from '../lib/fit.js'
import { about, counted, fixed } from '../lib/format.js'
import { frame, minus } from '../lib/frame.js'
import { lettering } from '../lib/pen.js'
import { sensorOf, skin, tips } from '../lib/skin.js'
import { twins } from '../lib/twinpool.js'
import { workers } from '../lib/workers.js'

const REST_MS = 150, SLOW_MS = 600
const DRAG_PX = 4 // A hand that clicks moves less.
const SLOW = 'Computing: the first answer for a skin builds its model, which takes some seconds …'
const NEW = { kind: 'force_n', value: 20 }
const VIEWS = [['difference', 'Difference from untouched'], ['frame', 'Frame'], ['untouched', 'Untouched']]
const TRIAL_VIEWS = [['measured', 'Measured, trial'], ['residual', 'Measured minus simulated']]

/** Shows the page. */
export async function show(root, { query, signal, set }) {
  const state = { contacts: [], text: '', answer: null, trial: null, trialId: '', run: '', view: 'difference', held: -1, on: -1, from: [0, 0], moved: false }
  const bend = dent(signal)
  const drawn = skin({ title: 'Skin under the model', points: true, signal, label: () => 'simulated', describe, draw, onpick: pick, ondrag: drag,
    onhover: hover,
    data: () => ({ heads: ['x_mm', 'y_mm', 'force_n', 'depth_mm'], rows: (state.answer?.contacts ?? []).map(c => [c.x_mm, c.y_mm, c.force_n, c.depth_mm]) }) })
  const list = contactList(edit), told = el('p', { className: 'said', role: 'status' }), numbers = el('div')
  const voltages = frame({ title: 'Voltages', name: 'simulated-frame', label: () => `simulated, ${viewWords()}`, signal })
  const picker = el('div', { className: 'row' }), against = scatter({ title: 'Trial: measured against simulated', key: 'trial', label: () => state.trial?.label, signal })
  const trialForm = form(() => {
    state.trialId = null // The same trial again has its own contacts again.
    set({ trial: trialInput.value, contacts: null })
  }, { className: 'row' })
  const trialInput = el('input', { type: 'number', min: 1, id: 'model-trial', className: 'short' }), trialWords = el('p', { className: 'soft' })
  const scatterPane = pane(against.node)
  const without = button('Without', () => set({ trial: null }), { className: 'plain', hidden: true })
  trialForm.append(el('label', { className: 'inline', htmlFor: 'model-trial' }, 'Compare with stored trial'), trialInput, el('button', {}, 'Take it'),
    without)
  const below = fit({ choose: run => set({ fit: run }), signal })

  root.append(el('div', { className: 'columns two' },
    el('div', { className: 'column' }, pane(drawn.node, bend.legend,
      el('p', { className: 'soft small' }, `Click adds a contact (at most ${most()}), drag moves it. By keyboard: arrows, Enter, and the list.`)),
      panel('Answer', {}, numbers, told)),
    el('div', { className: 'column' },
      panel('Contacts', {}, list.node, el('div', { className: 'row' }, button('Add a contact', () => drawn.shape ? add(apart()) : note(told, 'The skin is not known yet.')),
        button('Remove all', () => state.contacts.length ? put([]) : note(told, 'There is no contact to remove.'), { className: 'plain' })),
        trialForm, trialWords),
      pane(voltages.node, picker))), scatterPane, below.node, twins(signal), workers(signal))

  const centre = () => [drawn.shape.width_mm / 2, drawn.shape.height_mm / 2]
  // A place 60 mm from every contact, as near the centre as there is one on a grid of 30 mm.
  const apart = () => {
    const { width_mm: w, height_mm: h, tip_diameter_mm: rim } = drawn.shape, [x, y] = centre(), far = ([a, b], [c, d]) => Math.hypot(a - c, b - d)
    const grid = Array.from({ length: 15 * 15 }, (_, i) => [x + 30 * (i % 15 - 7), y + 30 * (Math.floor(i / 15) - 7)])
      .filter(([a, b]) => a > rim && b > rim && a < w - rim && b < h - rim).sort((a, b) => far(a, [x, y]) - far(b, [x, y]))
    return grid.find(p => state.contacts.every(c => far(p, [c.x_mm, c.y_mm]) >= 59)) ?? [x, y]
  }
  const viewWords = () => [...VIEWS, ...TRIAL_VIEWS].find(([name]) => name === state.view)?.[1].toLowerCase() ?? ''

  // Contacts: changed by mouse, list or address; asked for after a rest.
  const asking = replacing(signal)
  let timer = 0
  function put(contacts) {
    state.contacts = contacts.slice(0, most()).map(contact => within(contact, drawn.shape))
    list.show(state.contacts, null, drawn.shape)
    drawn.redraw()
    clearTimeout(timer)
    timer = setTimeout(() => { state.text = contactsText(state.contacts); set({ contacts: state.text }); simulate() }, REST_MS)
  }
  signal.addEventListener('abort', () => clearTimeout(timer))
  const add = ([x_mm, y_mm]) => state.contacts.length < most()
    ? put([...state.contacts, { ...NEW, ...(({ kind, value }) => kind && { kind, value })(state.contacts.at(-1) ?? {}), x_mm, y_mm }])
    : note(told, `At most ${most()} contacts: remove one first.`)
  function edit(i, change) {
    if (!change) return put(state.contacts.filter((_, k) => k !== i))
    const found = state.answer?.contacts?.[i]
    // Given by the other quantity: the value that the model found for it keeps the contact as it is.
    if (change.kind && change.kind !== state.contacts[i].kind) change.value = +(found?.[change.kind] ?? (change.kind === 'force_n' ? 20 : 1)).toFixed(2)
    return put(state.contacts.map((contact, k) => k === i ? { ...contact, ...change } : contact))
  }
  const under = ([x, y]) => state.contacts.findIndex(c => Math.hypot(c.x_mm - x, c.y_mm - y) < Math.max(12, drawn.shape.tip_diameter_mm * 0.7))
  function drag(kind, mm, event) {
    if (kind === 'down') {
      state.held = state.on = under(mm)
      state.from = [event.clientX, event.clientY]
      state.moved = false
      if (state.held >= 0) drawn.canvas.setPointerCapture(event.pointerId)
    } else if (kind === 'move' && state.held >= 0 && event.buttons) {
      state.moved ||= Math.hypot(event.clientX - state.from[0], event.clientY - state.from[1]) >= DRAG_PX
      if (state.moved) put(state.contacts.map((c, i) => i === state.held ? { ...c, x_mm: mm[0], y_mm: mm[1] } : c))
    } else if (kind === 'up') state.held = -1
  }
  function pick(mm, event) {
    const { width_mm: w, height_mm: h } = drawn.shape
    const had = state.contacts.length, on = event ? state.on : -1 // A key has no press before it.
    state.on = -1
    if (on >= 0) return state.moved || choose(on)
    if (mm[0] >= 0 && mm[1] >= 0 && mm[0] <= w && mm[1] <= h) add(mm)
    return state.contacts.length > had ? `Contact ${had + 1} is pressed here.` : told.textContent
  }
  /** A press on a contact: its load has the focus, so that it can be typed. */
  function choose(i) {
    note(told, `Contact ${i + 1}: drag moves it; its load is in the list.`)
    list.focus(i)
  }
  function hover(mm) {
    const grid = state.answer?.dent_mm
    if (!mm || !grid) return ''
    const [i, k] = [(mm[0] - grid.x0_mm) / grid.pitch_mm, (mm[1] - grid.y0_mm) / grid.pitch_mm].map(Math.round)
    return i >= 0 && k >= 0 && i < grid.columns && k < grid.rows
      ? `x ${fixed(mm[0], 0)}, y ${fixed(mm[1], 0, 'mm')}: ${fixed(grid.values[k * grid.columns + i], 2, 'mm')} deep` : ''
  }

  async function simulate() {
    const until = asking(), begun = performance.now()
    const slow = setTimeout(() => { if (!until.aborted) note(told, SLOW) }, SLOW_MS)
    try {
      const answer = await send('/simulations', { contacts: asked(state.contacts), run: state.run || state.trial?.run || null, trial: state.trial?.trial_id ?? null },
        { signal: until, wait: 120_000 })
      clearTimeout(slow)
      if (until.aborted) return
      state.answer = answer
      tell(performance.now() - begun)
    } catch (error) {
      clearTimeout(slow)
      if (until.aborted) return
      state.answer = null
      fill(numbers)
      note(told, error.status === 404 && !state.run ? 'This version of the service answers no simulations here. The command: palpate simulate --contacts.'
        : `No answer: ${error.message}`)
      told.className = 'said bad'
    }
    bend.take(state.answer?.dent_mm ?? null)
    list.show(state.contacts, state.answer?.contacts, drawn.shape)
    drawn.redraw()
    drawFrame()
  }
  function tell(round) {
    const { answer, trial } = state
    told.className = 'said'
    note(told, '')
    fill(numbers, facts([['Deepest', fixed(bendMost(answer), 2, 'mm')],
      ['Sum of forces', fixed(answer.contacts.reduce((sum, c) => sum + c.force_n, 0), 1, 'N')], ['Computed in', fixed(answer.took_ms, 1, 'ms')],
      ['Throughput', `${about(1000 / answer.took_ms)}\u202f/s`],
      ['Until shown', fixed(round, 0, 'ms')], ['Model', answer.model],
        ...(trial ? [['FVU of this', fixed(answer.fvu, 3)], ['FVU of its twin', fixed(trial.fvu, 3)]] : [])]))
  }
  const bendMost = answer => answer.dent_mm.values.reduce((a, b) => Math.max(a, b), 0)

  function drawFrame() {
    const { answer, trial, view } = state
    const choices = [...VIEWS, ...(trial?.voltages_v ? TRIAL_VIEWS : [])]
    renew(picker, choices, () => el('label', { className: 'inline' }, 'Shown', select(choices, view, next => set({ view: next === 'difference' ? null : next }))))
    picker.querySelector('select').value = view
    const v = answer?.voltages_v, values = { difference: () => minus(v, answer?.untouched_v), frame: () => v, untouched: () => answer?.untouched_v,
      measured: () => trial?.voltages_v, residual: () => minus(trial?.voltages_v, v) }[view]?.()
    if (values) voltages.show(values)
    scatterPane.hidden = !(trial?.voltages_v && v)
    if (!scatterPane.hidden) against.set(trial.voltages_v.map((measured, i) => [measured, v[i]]))
  }

  function draw(pen, view, shape) {
    bend.draw(pen, view)
    tips(pen, view, state.contacts.map(c => [c.x_mm, c.y_mm]), shape.tip_diameter_mm, { stroke: view.colour('--ink'), width: 2 })
    pen.font = '600 12px system-ui, sans-serif'
    pen.textBaseline = 'middle'
    state.contacts.forEach((contact, i) => {
      const force = contact.kind === 'force_n' ? contact.value : state.answer?.contacts?.[i]?.force_n, words = `${i + 1}: ${fixed(force, 1, 'N')}`
      const left = contact.x_mm > shape.width_mm - 90, x = view.x(contact.x_mm) + (left ? -1 : 1) * (shape.tip_diameter_mm / 2 * view.scale + 6),
        y = view.y(contact.y_mm)
      pen.textAlign = left ? 'right' : 'left'
      lettering(pen, words, x, y, view.colour('--ink'), view.colour('--skin'))
    })
  }
  function describe() {
    const each = state.contacts.map((c, i) => `; ${i + 1} at x ${Math.round(c.x_mm)}, y ${Math.round(c.y_mm)} mm`)
    return `Skin with ${counted(each.length, 'contact')}${each.join('')}. Contacts can be added and changed in the list.`
  }

  /** A stored trial: its contacts are pressed, unless the address has others. */
  async function take(id, keep) {
    state.trialId = id
    state.trial = null
    trialInput.value = id
    without.hidden = !id
    say(trialWords, '')
    if (!id) return
    try {
      const trial = await get(`/trials/${encodeURIComponent(id)}`, {}, { signal })
      if (state.trialId !== id) return
      state.trial = trial
      // What pressed: every tip with a force, those below the deadband as well, as for the twin.
      const pressed = trial.arms?.filter(arm => arm.force_n > 0).length ? trial.arms.filter(arm => arm.force_n > 0) : trial.contacts
      say(trialWords, `Trial ${trial.trial_id} of run ${trial.scan_id} (${trial.experiment}, ${trial.label}): ${counted(pressed.length, 'tip')} with a force.`)
      if (!keep) put(pressed.slice(0, most()).map(c => ({ x_mm: c.x_mm, y_mm: c.y_mm, kind: 'force_n', value: +(c.force_n ?? 0).toFixed(3) })))
    } catch (error) { if (state.trialId === id && !signal.aborted) say(trialWords, `Trial ${id}: ${error.message}`) }
  }

  let newest = query
  async function update(next) {
    newest = next
    state.view = next.view ?? 'difference'
    below.show(next.fit ?? '')
    const { run = '', trial = '' } = next, other = trial !== state.trialId, asks = run !== state.run || other
    state.run = run
    if (other) await take(trial, Boolean(next.contacts))
    if (signal.aborted || state.trialId !== trial) return // Another trial is taken meanwhile.
    next = newest
    const first = drawn.shape ? [{ ...NEW, x_mm: centre()[0], y_mm: centre()[1] }] : []
    const text = next.contacts ?? (trial && state.trial ? state.text || null : contactsText(first))
    if (text != null && text !== state.text) {
      state.text = text
      state.contacts = parseContacts(text).map(contact => within(contact, drawn.shape))
      list.show(state.contacts, null, drawn.shape)
      simulate()
    } else if (asks && !(other && state.trial && !next.contacts)) simulate()
    drawn.redraw()
    drawFrame()
  }
  sensorOf(query.run).then(shape => { drawn.geometry(shape) },
    error => { note(told, `The skin is not known: ${error.message}`) }).then(() => update(newest))
  return { update }
}
