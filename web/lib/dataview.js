// The data as they come: the live frame against the untouched one, the last trial and its twin, all in the
// same colours with the same end, so that two glances can be compared.

import { Refused, get, socket } from './api.js'
import { el, every, fill, note, onBeat, say, select } from './dom.js'
import { age, clock, counted, fixed, moment, span } from './format.js'
import { frame, minus } from './frame.js'
import { live } from './live.js'

/** What the left picture shows. */
const VIEWS = [
  ['', 'Live, difference from untouched'], ['voltages', 'Live, voltages'], ['trial', 'Last trial, difference'], ['misfit', 'Last trial minus its twin'],
]
const SCALES = [['0.1', '0.1 V'], ['', '0.5 V'], ['2', '2 V'], ['10', '10 V']]
const LOOK_MS = 5000, OLD_MS = 2000

/**
 * Makes the pictures. `state` is { frame, scale } of the address. `run` gives the run whose last trial is
 * shown; `onfacts({ trial, stuck, saturated, channels })` hears what was seen.
 */
export function dataView({ state, set, signal, label, onfacts = () => {} }) {
  const left = frame({ title: 'Frame', name: 'live-frame', signal, label,
    query: () => state.frame === 'trial' || state.frame === 'misfit' ? `/api/v1/trials/${trial?.trial_id ?? ''}` : '/api/v1/frames/untouched' })
  const right = frame({ title: 'Twin', name: 'twin', signal, label, query: () => `/api/v1/trials/${trial?.trial_id ?? ''}` })
  const views = select(VIEWS, state.frame ?? '', value => set({ frame: value }), { 'aria-label': 'Left picture' })
  const scales = select(SCALES, state.scale ?? '', value => set({ scale: value }), { 'aria-label': 'End of the colours' })
  const twinWords = el('p', { className: 'soft small hold' }), frameWords = el('p', { className: 'soft small hold' })
  const lost = el('p', { className: 'warn small' })
  const twin = el('div', {}, right.node, twinWords)
  let untouched = null, why = '', newest = null, trial = null, parsed = null, run = null, arrived = 0, wasOld = false
  note(lost, '')

  const isLive = () => !['trial', 'misfit'].includes(state.frame)
  const end = () => Number(state.scale) || 0.5
  // The newest frame says nothing of now if it came long ago, or if the wires were closed since.
  const old = () => live.status?.rig.state === 'disconnected' || Date.now() - arrived > OLD_MS
  const title = node => node.querySelector('figcaption span')

  function draw() {
    if (newest) parsed = JSON.parse(newest)
    newest = null
    const stale = wasOld = old()
    left.node.classList.toggle('old', stale && isLive())
    const marks = parsed && isLive() && !stale ? { stuck: parsed.stuck, saturated: parsed.saturated } : undefined
    if (isLive()) {
      const differs = state.frame !== 'voltages' && untouched
      say(title(left.node), differs ? 'Live minus untouched' : 'Live frame')
      left.show(differs ? minus(parsed?.voltages_v, untouched.voltages_v) : parsed?.voltages_v ?? null, { scale: end(), marks })
      tellLive()
    } else {
      const of = state.frame === 'misfit' ? trial?.sim_voltages_v : untouched?.voltages_v
      say(title(left.node), state.frame === 'misfit' ? 'Last trial minus twin' : of ? 'Last trial minus untouched' : 'Last trial')
      left.show(state.frame === 'misfit' ? minus(trial?.voltages_v, of) : minus(trial?.voltages_v, of) ?? trial?.voltages_v ?? null, { scale: end() })
      say(frameWords, trial ? trialWords(trial) : 'No trial is stored yet.')
    }
    if (parsed) onfacts(stale ? { stuck: null, saturated: null } : { stuck: parsed.stuck, saturated: parsed.saturated })
  }
  // The untouched frame of a rig is named below its frames; an old frame has its age there.
  const tellLive = () => {
    const stale = parsed && old()
    say(frameWords, stale ? `Old: the last frame came at ${clock(arrived)}, ${span(Math.floor(age(arrived)))} ago.` : liveWords())
    frameWords.classList.toggle('warn', Boolean(stale))
  }
  // Frames come at 30 per second and more; a picture that a person compares needs ten.
  const later = onBeat(() => { if (!signal.aborted) draw() })

  function drawTwin() {
    const sim = trial?.sim_voltages_v, differs = sim && untouched
    twin.hidden = !sim
    say(title(right.node), differs ? 'Twin minus untouched' : 'Twin')
    if (sim) right.show(minus(sim, untouched?.voltages_v) ?? sim, { scale: end() })
    const fit = trial?.fvu == null ? '' : `, FVU ${fixed(trial.fvu, 3)}`
    if (sim) fill(twinWords, `${trialWords(trial)}${fit}. `, el('a', { href: `/trials?trial=${trial.trial_id}` }, 'Show it'))
  }
  function liveWords() {
    if (!parsed) return 'No frame has come yet: connect the rig, or check the stream.'
    if (state.frame === 'voltages') return 'Voltages as they come.'
    if (!untouched) return `Voltages, since there is no untouched frame (${why || 'none yet'}).`
    return `Untouched: ${counted(untouched.frames, 'frame')}, ${moment(untouched.at)}${untouched.run && untouched.run === run ? ', in this run' : ''}.`
  }
  function trialWords(t) {
    const depth = t.depth_mm == null ? 'weights' : fixed(t.depth_mm, 1, 'mm')
    return `Trial ${t.trial_id}: configuration ${t.configuration}, ${depth}, ${span(age(t.measured_at))} ago`
  }

  async function look() {
    await Promise.all([lookUntouched(), lookTrial()])
    if (!signal.aborted) { drawTwin(); if (!isLive() || !parsed) draw() }
  }
  async function lookUntouched() {
    try { untouched = await get('/frames/untouched', {}, { signal }); why = '' } catch (error) {
      if (error instanceof Refused) untouched = null
      why = error.message
    }
  }
  // The newest trial with a twin: twins follow their trials by some seconds.
  async function lookTrial() {
    const of = run
    if (!of) return
    const ask = more => get(`/runs/${of}/trials`, { limit: 1, sort: '-trial_id', voltages: true, ...more }, { signal })
    try {
      let { items } = await ask({ fvu__gte: 0 })
      if (!items.length) ({ items } = await ask())
      if (of !== run) return // Another run is shown meanwhile.
      trial = items[0] ?? null
      onfacts({ trial })
    } catch { /* Asked again in some seconds; the age of what is shown is with it. */ }
  }

  socket('/frames/live', {
    signal, raw: true, rest: true, onmessage(text) { newest = text; arrived = Date.now(); if (isLive()) later() },
    onstate: open => note(lost, open || document.hidden ? '' : 'No live frames: the connection is tried again.'),
  })
  const watch = setInterval(() => {
    if (document.hidden || !parsed) return
    if (old() !== wasOld) draw()
    else if (wasOld && isLive()) tellLive()
  }, 1000)
  signal.addEventListener('abort', () => clearInterval(watch))
  every(LOOK_MS, look, signal)
  draw()
  return {
    node: el('div', {}, lost, el('div', { className: 'pair frames' }, el('div', {}, left.node, frameWords), twin)),
    controls: el('span', { className: 'row tight' }, views, scales),
    run(uid) { if (uid !== run) { run = uid; trial = null; lookTrial().then(() => { if (!signal.aborted) { drawTwin(); draw() } }) } },
    update(next) { state = next; views.value = state.frame ?? ''; scales.value = state.scale ?? ''; draw(); drawTwin() },
  }
}
