// Manual trials: which weight goes where, now? One instruction, read by a person at the rig, and what the
// skin feels of it. Confirmed by a key or a foot switch; a press confirms the shown placement alone. Its address: weight.

import { hold } from '../lib/address.js'
import { get, person } from '../lib/api.js'
import { actOnRig, actOnRun, actor, confirm, named, only, outcome, runButtons, runRefusal } from '../lib/actions.js'
import { button, el, fill, note, pane, renew, say, sleep } from '../lib/dom.js'
import { fold } from '../lib/fold.js'
import { age, clock, count, counted, countOf, listed, span } from '../lib/format.js'
import { live, rigLabel, who } from '../lib/live.js'
import { lockWords } from '../lib/lock.js'
import { manual } from '../lib/manual.js'
import { overlay } from '../lib/overlay.js'
import { STAGES, drawPlacement, feltOf, isRead, kilograms, newtons, notYet, present, rest, spot, verdict } from '../lib/placing.js'
import { sensorOf, skin } from '../lib/skin.js'

const PERIOD_MS = 333, OLD_MS = 5000
const KEYS = ['Enter', ' ', 'PageDown']

/** Shows the page. */
export async function show(root, { signal }) {
  const idle = manual(outcome(), { signal }), work = placing(signal)
  let shown = null
  const view = placement => {
    const wanted = placement ? work : idle
    if (wanted !== shown) {
      shown = wanted
      fill(root, wanted.node)
      if (wanted === idle) idle.load()
      else if (live.may('operator')) named().then(work.draw)
    }
    placement ? work.take(placement) : idle.tell(live.status?.run)
  }
  watch(view, work.draw, signal)
  live.on('fresh', work.draw, signal)
  live.onChange(status => status.queue_length, () => shown === idle && idle.load(), signal)
  return { update() {} } // The parts follow the address themselves.
}

/** Asks for the placement while a manual run is active, three times a second; calls `take` with it or null, `failed` without an answer. */
async function watch(take, failed, signal) {
  const kinds = new Map()
  for (let begun = 0; !signal.aborted; await sleep(Math.max(100, begun + PERIOD_MS - Date.now()), signal)) {
    begun = Date.now()
    const run = live.status?.run
    if (document.hidden || !live.fresh) continue
    if (!run) { take(null); continue }
    try {
      if (run.wanted?.trial == null && !kinds.has(run.uid)) kinds.set(run.uid, (await get(`/runs/${run.uid}`, {}, { signal })).kind)
      if (run.wanted?.trial == null && kinds.get(run.uid) !== 'real-random') { take(null); continue }
      take(await get('/placement', {}, { signal, wait: 2000 }))
    } catch (error) {
      // 404: nothing is asked. A status that asks is newer: what is shown stays for this moment.
      if (error.status === 404 && !signal.aborted && live.status?.run?.wanted?.trial == null) take(null)
      else failed()
    }
  }
}

/** The placement at work: skin, instruction, and the one button. */
function placing(signal) {
  const said = outcome(), state = { placement: null, readAt: 0, open: false, sent: null, sentAt: 0, unrestSince: 0, chosen: null, refused: '', failed: '' }
  const view = skin({ title: 'Skin', tall: true, signal, label: rigLabel, describe, draw: (pen, scale, shape) => state.placement
    && drawPlacement(pen, scale, shape, state.placement, now()) })
  const head = el('span', { className: 'big' }), resting = el('span', { className: 'soft' }), bar = el('progress'), weights = el('ol', { className: 'weights' })
  const words = el('p', { className: 'verdict', role: 'status' }), refusal = el('p', { className: 'verdict bad', role: 'alert', hidden: true }),
    hint = el('p', { className: 'soft' })
  const done = only('operator', button('Done', () => press(false), { className: 'main done' }))
  const anyway = only('operator', button('Store anyway', storeAnyway, { className: 'danger', hidden: true }))
  const again = only('operator', button('Repeat the last one', repeat))
  const zero = el('span', { className: 'soft' }), tare = actor('Tare the empty skin', said, () => actOnRig('tare'))
  const by = el('p', { className: 'soft small' }), buttons = runButtons(said, { without: ['confirm'] })
  const node = el('div', { className: 'placing live' }, pane(view.node), el('section', { 'aria-label': 'What to do now' },
    el('div', { className: 'row spread' }, head, resting), bar, weights, words, refusal,
    el('div', { className: 'row' }, done, anyway), hint,
    el('div', { className: 'row' }, tare, zero), el('div', { className: 'row' }, again, buttons.node), said.node, by,
    fold('overlay', 'Overlay to print', { signal }, overlay())))
  const now = () => state.placement?.contacts.find(({ number }) => number === (state.chosen ?? present(state.placement)))
  for (const kind of ['status', 'fresh']) live.on(kind, buttons.show, signal)
  const write = hold('weight', { take: text => { state.chosen = Number(text) || null; draw() }, text: () => state.chosen && String(state.chosen), signal })

  function describe() {
    const { placement } = state
    if (!placement) return 'Skin'
    const each = placement.contacts.map(c => `${c.number}: ${kilograms(c.force_n)} at ${spot(c)}`)
    return `Skin with ${counted(each.length, 'weight')}: ${each.join('; ')}`
  }

  function take(placement) {
    const other = placement.trial !== state.placement?.trial || placement.run !== state.placement?.run
    if (placement.run !== state.placement?.run) sensorOf(placement.run).then(shape => placement.run === state.placement.run && view.geometry(shape), () => {})
    // The weight of the address is that of the placement at which the page was opened.
    if (other) Object.assign(state, { chosen: state.placement ? null : state.chosen, refused: '', failed: '' })
    if (!placement.contacts.some(({ number }) => number === state.chosen)) state.chosen = null
    if (other || placement.stage !== 'place' || Date.now() - state.sentAt > 5000) state.sent = null
    if (placement.verdict?.kind !== 'wrong') state.refused = ''
    if (placement.stage !== 'place') state.failed = '' // It has arrived.
    if (other || isRead(placement)) state.unrestSince = Date.now()
    Object.assign(state, { placement, readAt: Date.now() })
    if (other) write()
    draw()
  }
  function choose(number) {
    state.chosen = number
    write()
    draw()
  }

  function draw() {
    const { placement } = state
    if (!placement || signal.aborted) return
    const why = lockWords() || notYet(placement, { ...state, fresh: live.fresh }), busy = placement.stage !== 'place'
    say(head, `Trial ${countOf(placement.done + 1, placement.of)}${placement.repeated ? `, ${count(placement.repeated)} repeated` : ''}`)
    const isOld = Math.abs(Date.now() - state.readAt) > OLD_MS
    node.classList.toggle('old', isOld)
    say(resting, isOld ? `The skin was last read at ${clock(state.readAt)}: what is shown is old.` : rest(placement))
    Object.assign(bar, { max: placement.of, value: placement.done, ariaLabel: `${placement.done} of ${placement.of} trials stored` })
    drawWeights(placement)
    const { words: judged, tone } = busy ? { words: STAGES[placement.stage] ?? '', tone: '' } : verdict(placement)
    say(words, judged)
    words.className = `verdict ${tone}`
    note(refusal, state.failed || (state.refused && !judged.includes(state.refused) ? state.refused : ''))
    done.disabled = Boolean(why) || busy
    anyway.hidden = placement.verdict?.kind !== 'wrong' || busy
    anyway.disabled = done.disabled
    say(hint, !live.may('operator') ? 'You see what is asked. To confirm it you need the key of an operator.' : why
      || (busy ? 'The next placement appears by itself.' : `${STAGES.place} Keys: Enter, Space, Page Down.`))
    const refused = live.status?.run ? runRefusal(live.status, 'repeat') : ''
    again.disabled = !placement.last || busy || state.open || Boolean(lockWords() || refused)
    again.title = refused || (placement.last ? `Withdraws trial ${placement.last.trial + 1} and asks for it again` : 'No trial of this run can be repeated yet')
    const { untouched_at: at } = placement
    say(zero, at ? `Untouched ${span(Math.floor(age(at)))} ago. Lift all weights for five seconds before you place the next.`
      : 'Take everything off the skin and tare it: the offsets of the readout drift.')
    if (!tare.dataset.busy) tare.disabled = busy
    say(by, `Placed by ${who() || 'a name that is asked for at the first press'}. The run waits as long as you need.`)
    view.redraw()
  }

  function drawWeights(placement) {
    const chosen = now()?.number
    const of = [placement.trial, placement.run, chosen, placement.stage,
      placement.contacts.map(({ number }) => Math.round(feltOf(placement, number)?.distance_mm ?? -1)), placement.verdict?.kind, Boolean(placement.felt)]
    renew(weights, of, () => placement.contacts.map(contact => {
      const felt = feltOf(placement, contact.number), judged = placement.felt && placement.verdict?.kind !== 'unknown'
      const state_ = !judged ? '' : felt ? felt.contact.force_n == null ? `felt ${Math.round(felt.distance_mm)} mm away`
        : `felt ${Math.round(felt.distance_mm)} mm away, ${newtons(felt.contact.force_n)}` : 'not felt'
      return el('li', { 'aria-current': contact.number === chosen ? 'step' : 'false', className: contact.number === chosen ? 'now' : '' },
        el('button', { type: 'button', className: 'weight', 'aria-label': `Weight ${contact.number}: ${kilograms(contact.force_n)} at ${spot(contact)}`,
          onclick: () => choose(contact.number) },
          el('span', { className: 'number-badge' }, String(contact.number)),
            el('span', { className: 'mass' }, kilograms(contact.force_n).split('\u202f')[0], el('span', { className: 'unit' }, '\u202fkg')),
            el('span', { className: 'point' }, spot(contact))),
        el('p', { className: 'soft' }, listed([newtons(contact.force_n), contact.point && `x ${contact.x_mm.toFixed(0)}, y ${contact.y_mm.toFixed(0)} mm`,
          state_], ' · ')))
    }))
  }

  async function press(sure) {
    const { placement } = state
    if (done.disabled || !placement || !live.may('operator') || lockWords() || notYet(placement, { ...state, fresh: live.fresh })) return
    Object.assign(state, { open: true, failed: '' })
    draw()
    try {
      if (!await named()) return
      await actOnRun(placement.run, 'confirm', { trial: placement.trial, ...(sure && { anyway: true }) })
      Object.assign(state, { sent: placement.trial, sentAt: Date.now(), refused: '' })
      said.tell('')
    } catch (error) {
      // What the skin contradicts is shown while it does, with the other button; anything else until the next press.
      if (error.status && state.placement.verdict?.kind === 'wrong') state.refused = error.message
      else state.failed = error.status ? `Not confirmed: ${error.message}` : `Not confirmed: no answer (${error.message}). Press again.`
    } finally {
      state.open = false
      draw()
    }
  }

  async function storeAnyway() {
    const { placement } = state
    const sure = await confirm('Store this placement although the skin contradicts it?',
      [verdict(placement).words, 'The trial is stored with the requested weights as labels and the flag “doubted”.'], 'Store anyway')
    // What was confirmed is what was shown: not a placement that came meanwhile.
    if (sure && state.placement.trial === placement.trial) press(true)
  }

  async function repeat() {
    const { last, run } = state.placement
    if (!await named() || !await confirm(`Repeat trial ${last.trial + 1}?`, 'Its stored measurement is withdrawn, and the same weights are asked again.',
      'Repeat it')) return
    const why = `repeated on the page by ${person.name || who()}`
    await said.run('Repeat', () => actOnRun(run, 'repeat', { trial: last.trial, why }))
  }

  // A foot switch is a keyboard: no button may keep the focus after a click, or it would get the press.
  addEventListener('keydown', event => {
    if (!node.isConnected || event.ctrlKey || event.metaKey || event.altKey) return
    const at = event.target.closest?.('input, select, textarea, dialog, a, summary, button')
    if (at && at !== done || document.querySelector('dialog[open]')) return
    const step = { ArrowDown: 1, ArrowUp: -1 }[event.key], numbers = state.placement?.contacts.map(c => c.number) ?? []
    if (KEYS.includes(event.key)) {
      event.preventDefault()
      if (!event.repeat) press(false)
    } else if (step && numbers.length) {
      event.preventDefault()
      choose(numbers[(numbers.indexOf(now()?.number) + step + numbers.length) % numbers.length])
    } else if (numbers.includes(Number(event.key))) choose(Number(event.key))
  }, { signal })
  addEventListener('keyup', event => { if (event.target === done && KEYS.includes(event.key)) event.preventDefault() }, { signal })
  node.addEventListener('click', event => { if (event.detail > 0) event.target.closest('button')?.blur() })
  return { node, take, draw }
}
