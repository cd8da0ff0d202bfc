// The rig as a chain from wire to tip: each device with its last word and what is wrong with it.

import { el, fill, renew, say } from './dom.js'
import { NONE, about, count, counted, fixed, listed, moment, percent, span } from './format.js'

const BAD = [['timeouts', 'reply did not arrive in time', 'replies did not arrive in time'], ['garbled', 'reply was damaged', 'replies were damaged'],
  ['reconnects', 'reopening', 'reopenings'], ['retries', 'repeated request', 'repeated requests']]

/** A wire in words: { tone, words, figures }. `rate`: what it did in the last minute, null while that is not known. */
export function wireWords(wire, rate) {
  const wrong = rate ? BAD.filter(([key]) => rate[key] > 0) : []
  const bad = wrong.some(([key]) => key !== 'retries')
  const total = [counted(wire.requests, 'request'), counted(wire.timeouts, 'timeout'), `${count(wire.garbled)} garbled`, counted(wire.reconnects, 'reopening')]
  const found = wrong.map(([key, one, more]) => `${count(rate[key])} ${rate[key] === 1 ? one : more}`).join(', ')
  const words = !rate ? 'Counting …' : found ? `In the last ${span(rate.over_s)}: ${found}. Check its cable and its plug.`
    : rate.requests ? 'Every request of the last minute was answered.' : 'Open; nothing was asked in the last minute.'
  return { tone: bad ? 'bad' : wrong.length ? 'warn' : '', words,
    figures: [['Requests', rate?.requests_per_min == null ? NONE : `${about(rate.requests_per_min)} per min`],
    ['Last round trip', about(wire.last_round_trip_us, 'µs')]],
    since: `Since opened: ${total.join(', ')}.` }
}

/** The voltage stream in words. */
export function streamWords(stream, rate, rig) {
  if (!stream.frames) return { tone: rig.state === 'disconnected' ? '' : 'bad', words: rig.state === 'disconnected' ? 'Closed.'
    : 'No frame has arrived: check the readout and its cable.', figures: [] }
  const { frames = 0, missed = 0, garbled = 0 } = rate ?? {}
  const silent = rate && rate.over_s > 3 && frames === 0
  const harm = rig.clock_rate > 1 ? `: a rig that runs ${about(rig.clock_rate)} times as fast as the clock skips frames, no fault`
    : '. A trial waits for the frames that it needs'
  const words = !rate ? 'Counting …' : silent ? 'Silent: no frame arrives. Check the readout and its cable.' : garbled
    ? `${counted(garbled, 'damaged packet')} in the last ${span(rate.over_s)}: check the cable and the earth.`
    : missed ? `${percent(missed, frames + missed)} of the frames of the last ${span(rate.over_s)} are missing${harm}.`
      : 'No frame of the last minute is missing.'
  return { tone: silent ? 'bad' : garbled || missed && rig.clock_rate <= 1 ? 'warn' : '', words,
    figures: [['Frame rate', rate?.frames_per_s == null ? NONE : about(rate.frames_per_s, 'Hz')],
    ['Newest frame', stream.age_ms == null ? NONE : `${count(stream.age_ms)}\u202fms old`]],
    since: `Since opened: ${[counted(stream.frames, 'frame'), `${percent(stream.missed, stream.frames + stream.missed)} missed`,
      `${count(stream.garbled)} garbled`].join(', ')}.` }
}

/** Time and travel of a stop, in words. */
export function stoppingWords(stopping) {
  if (!stopping) return { tone: '', words: 'Known while a run presses or after one.', figures: [] }
  const { travel_mm, added_n, margin_n, measured_ms, measured_mm, sample_to_stop_ms, stops } = stopping
  const measured = listed([fixed(measured_ms, 2, 'ms'), measured_mm != null && fixed(measured_mm, 2, 'mm')])
  const over = added_n > margin_n * 1.000001
  return { tone: over ? 'bad' : '', words: over ? 'A stop may add more force than the margin allows: press more slowly.'
    : `A stop adds at most ${fixed(added_n, 1, 'N')} to a tip; ${fixed(margin_n, 1, 'N')} are allowed.`,
    figures: [['Travel until still', fixed(travel_mm, 2, 'mm')], ['Sample to stop', `${fixed(sample_to_stop_ms, 1, 'ms')} at most`],
      ['Measured', measured_ms == null ? 'never yet' : `${measured} in ${counted(stops, 'stop')}`]] }
}

/** The last stop, of the latched e-stop, otherwise of the last safe end: which axes it has not stopped, or how soon each acknowledged it. */
export function stopWords(rig, needs) {
  const last = rig.estop_stops.length ? rig.estop_stops : rig.safe_end?.stops ?? [], moving = needs.find(need => need.kind === 'not_stopped')
  const slowest = last.length && last.every(stop => stop.acknowledged_ms != null) ? Math.max(...last.map(stop => stop.acknowledged_ms)) : null
  const words = moving ? moving.words : slowest == null
    ? 'No stop has been sent since the wires were opened.' : `Every axis acknowledged the last stop within ${fixed(slowest, 2, 'ms')}.`
  return { tone: moving ? 'bad' : '', words, figures: last.map(stop => [stop.axis, stop.error ?? (stop.acknowledged_ms == null ? 'no answer'
    : `${fixed(stop.acknowledged_ms, 2, 'ms')}${stop.stood_ms == null ? '' : ', stands'}`)]) }
}

/** Makes a chain; `show([{ name, tone, words, figures, inside }])` draws it and changes only what differs. */
export function chain() {
  const node = el('ol', { className: 'chain' }), known = new Map()
  const link = name => {
    const words = el('span'), since = el('span', { className: 'soft since' }), figures = el('dl', { className: 'facts' }), more = el('div')
    return { node: el('li', {}, el('h3', {}, name), el('p', {}, words, ' ', since), figures, more), words, since, figures, more }
  }
  function show(items) {
    renew(node, items.map(({ name }) => name), () => items.map(({ name }) => {
      if (!known.has(name)) known.set(name, link(name))
      return known.get(name).node
    }))
    for (const { name, tone = '', words, since = '', figures = [], inside } of items) {
      const one = known.get(name)
      one.node.className = tone
      say(one.words, words)
      say(one.since, since)
      one.words.className = tone || 'soft'
      renew(one.figures, figures, () => figures.map(([key, value]) => el('div', {}, el('dt', {}, key), el('dd', {}, value))))
      if (inside && one.more.firstChild !== inside) fill(one.more, inside)
    }
  }
  return { node, show }
}

/** What a device last said, from the events: words with the time. */
export const lastWord = event => event ? `When the wires were opened, ${moment(event.at)}: ${event.data.found}` : ''
