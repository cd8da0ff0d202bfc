// The course of a run: trials per hour, retries, force and fit over the night, states as a band, events as
// marks that open their text, and how good the predictions of its end were. The night and the runs show it.

import { get } from './api.js'
import { chart } from './chart.js'
import { button, colour, el, fill, panel, say, select } from './dom.js'
import { counted, moment, plain, span } from './format.js'
import { LOUD, TONE } from './words.js'

const TONES = { good: '--live', warn: '--warn', bad: '--bad' }
// The first reading of a long run takes the service a while.
const READ_MS = 150_000
const ms = text => text == null ? null : Date.parse(text)
const seconds = text => ms(text) / 1e3

/** How the predicted end compares with the actual one, or with the newest estimate: a sentence, '' without any. */
function predictionWords({ predicted_s, elapsed_s, predictions = [], from }, endedAt, eta_s) {
  if (predicted_s == null || !from) return ''
  const planned = ms(from) + 1e3 * predicted_s, end = endedAt ?? (eta_s == null ? null : Date.now() + 1e3 * eta_s)
  const words = [`Predicted when it was armed: ${span(predicted_s)}, until ${moment(planned)}.`]
  if (end != null) {
    const late = (end - planned) / 60e3, verb = endedAt ? 'It ended' : 'It now ends about', near = Math.min(1, predicted_s / 600)
    words.push(Math.abs(late) < near ? `${verb} as predicted.` : `${verb} ${span(60 * Math.abs(late))} ${late > 0 ? 'later' : 'earlier'}.`)
  } else if (elapsed_s != null) words.push(`Elapsed: ${span(elapsed_s)}.`)
  if (predictions.length > 2) {
    const ends = predictions.map(p => ms(p.end))
    words.push(`Estimates since then: ${moment(Math.min(...ends))} to ${moment(Math.max(...ends))}.`)
  }
  return words.join(' ')
}

/**
 * Makes the panel. `state` is { from, to, night, event } of the address, `set` changes it. `show(run, extra)`
 * reads the history of a run and draws it; `update(state)` follows the address.
 */
export function history({ title = 'The night', state, set, signal, label, height = 170 }) {
  let data = null, run = null, facts = {}, shown = '', asked = 0
  const words = el('p', { className: 'soft small' }), text = el('p', { className: 'event-text', role: 'status' }), band = el('p', { className: 'legend' })
  const whole = button('Whole run', () => onselect(null, null), { className: 'plain', hidden: !state.from })
  const query = () => `/api/v1/runs/${run?.scan_id}/history?bins=${bins()}`
  const bins = () => state.from ? 1000 : 120
  /** Shows a part, or the whole without ends; returns whether there is something to change. */
  function onselect(low, high) {
    if (low == null && !state.from) return false
    set(low == null ? { from: null, to: null } : { from: Math.floor(low), to: Math.ceil(high) })
    return true
  }
  // A mark is chosen by a click near it, or by Enter at the point of the cursor.
  function onenter(x) {
    const near = data?.events.reduce((best, e) => (best && Math.abs(seconds(best.at) - x) <= Math.abs(seconds(e.at) - x) ? best : e), null)
    if (!near) return 'No event is marked.'
    set({ event: near.seq })
    return '' // The line below is spoken by itself.
  }
  const marks = u => drawMarks(u, data)
  const shared = { height, signal, label, query, onselect, onenter, marks }
  const rate = chart({ ...shared, key: 'rate', title: 'Trials per hour', y: 'Per hour', range: (_, high) => [0, Math.max(10, 1.15 * (high || 1))],
    series: [{ name: 'trials', digits: 0, steps: true, fill: true }, { name: 'failed attempts', digits: 0, steps: true, colour: '--bad' }] })
  const fit = chart({ ...shared, key: 'fit', title: 'Largest force and fit of the twins', y: 'Force', unit: 'N',
    series: [{ name: 'largest force', digits: 1, colour: '--c3' }, { name: 'median FVU', unit: '', digits: 3, axis: 'right', colour: '--c2' }],
    range: (_, high) => [0, Math.max(20, 1.15 * (high || 1))], right: { range: (_, low, high) => [0, Math.max(0.1, 1.15 * (high || 0))], label: 'FVU' } })
  const end = chart({ ...shared, key: 'end', title: 'Predicted end, against the actual or newest one', y: 'Later', unit: 'min',
    series: [{ name: 'likely', digits: 0 }, ...['early', 'late'].map(name => ({ name, digits: 0, colour: '--grey', dash: [3, 3] }))] })
  const second = el('div'), choice = select([['fit', 'Force and fit'], ['end', 'Predicted end']], state.night ?? 'fit',
    night => set({ night: night === 'fit' ? null : night }), { 'aria-label': 'Second chart' })
  const charts = el('div', { className: 'pair' }, rate.node, second)
  const aside = el('span', { className: 'row tight' }, whole, choice)
  const node = panel(title, { className: 'live', aside }, charts, el('div', { className: 'night-said' }, band, text), words)

  for (const one of [rate, fit, end]) one.node.addEventListener('click', event => pick(one.plot, event))
  function pick(u, event) {
    if (!u || !data) return
    const x = event.clientX - u.over.getBoundingClientRect().left
    const near = data.events.map(e => ({ e, d: Math.abs(u.valToPos(seconds(e.at), 'x') - x) })).sort((a, b) => a.d - b.d)[0]
    if (near?.d < 9) set({ event: near.e.seq })
  }
  async function openEvent() {
    const seq = state.event
    if (!seq) return say(text, data?.events.length ? 'Choose a mark to read what happened.' : '')
    try {
      const { items } = await get('/events', { since: seq - 1, limit: 1 }, { signal })
      if (seq !== state.event) return null // Another mark was chosen meanwhile.
      const found = items.find(event => event.seq === Number(seq))
      return say(text, found ? `${moment(found.at, true)}: ${found.words}` : 'This event is no longer stored.')
    } catch (error) { return signal.aborted || seq !== state.event ? null : say(text, `The event could not be read: ${error.message}`) }
  }

  // What is drawn of another run would be read as of this one.
  function clear() {
    data = null
    shown = ''
    rate.set([[], [], []])
    fit.set([[], [], []])
    end.set([[], [], [], []])
    fill(band)
    say(text, '')
  }
  function draw() {
    if (!data?.from) {
      if (data) say(words, 'This run has not started.')
      return
    }
    const first = seconds(data.from), low = Number(state.from) || -Infinity, high = Number(state.to) || Infinity
    const kept = data.trials.map((_, i) => i).filter(i => { const t = first + i * data.bin_s; return t + data.bin_s >= low && t <= high })
    const x = kept.map(i => first + i * data.bin_s), per = 3600 / data.bin_s
    const column = (values, scale = 1) => kept.map(i => values[i] == null ? null : scale * values[i])
    rate.set([x, column(data.trials, per), column(data.attempts_failed, per)])
    fit.set([x, column(data.largest_force_n), column(data.fvu)])
    const told = data.predictions.filter(p => seconds(p.at) >= low && seconds(p.at) <= high)
    const aim = facts.endedAt ?? ms(data.predictions.at(-1)?.end)
    end.set([told.map(p => seconds(p.at)), ...['end', 'low', 'high'].map(key => told.map(p => (ms(p[key]) - aim) / 60e3))])
    whole.hidden = !state.from
    say(words, predictionWords(data, facts.endedAt, facts.eta_s))
    const kinds = [...new Set(data.states.map(s => s.state))]
    const lasted = kind => data.states.filter(s => s.state === kind).reduce((sum, s) => sum + ((ms(s.to) ?? ms(data.to)) - ms(s.from)) / 1e3, 0)
    fill(band, kinds.map(kind => el('span', {}, el('i', { className: `tone-${TONE[kind] ?? 'none'}` }), `${plain(kind)} ${span(lasted(kind))}`)),
      data.events.length > 0 && el('span', {}, counted(data.events.length, 'mark')))
  }
  function place() {
    const wanted = state.night === 'end' ? end.node : fit.node
    if (second.firstChild !== wanted) fill(second, wanted)
    if (choice.value !== (state.night ?? 'fit')) choice.value = state.night ?? 'fit'
  }
  place()
  return {
    node,
    async show(next, more = {}) {
      const mine = asked += 1
      if (run && run.uid !== next.uid) clear()
      run = next
      facts = more
      try {
        if (!data) say(words, 'Reading the history of this run …')
        const read = await get(`/runs/${next.scan_id}/history`, { bins: bins() }, { signal, wait: READ_MS })
        if (mine !== asked) return // Another run is shown meanwhile, or the same one was read again.
        data = read
        draw()
        if (shown !== state.event) { shown = state.event; openEvent() } else if (!state.event) openEvent()
      } catch (error) { if (!signal.aborted && mine === asked) say(words, `The history of this run could not be read: ${error.message}`) }
    },
    update(next) {
      const zoomed = next.from !== state.from || next.to !== state.to, opened = next.event !== state.event
      state = next
      place()
      if (opened) { shown = state.event; openEvent() }
      if (run && zoomed) { draw(); this.show(run, facts) }
    },
  }
}

// States as a strip under the curves, waits shaded over the whole height, events as triangles above.
function drawMarks(u, data) {
  if (!data?.from) return
  const pen = u.ctx, ratio = window.devicePixelRatio || 1, { left, top, width, height } = u.bbox
  const x = t => Math.max(left, Math.min(left + width, u.valToPos(t / 1e3, 'x', true)))
  pen.save()
  for (const one of data.states) {
    const from = x(ms(one.from)), to = x(ms(one.to) ?? ms(data.to)), tone = TONE[one.state]
    if (to <= from) continue
    pen.fillStyle = colour(TONES[tone] ?? '--grey')
    pen.fillRect(from, top + height - 4 * ratio, to - from, 4 * ratio)
    if (tone && tone !== 'good') { pen.globalAlpha = 0.12; pen.fillRect(from, top, to - from, height); pen.globalAlpha = 1 }
  }
  for (const one of data.events) {
    const at = u.valToPos(seconds(one.at), 'x', true)
    if (at < left || at > left + width) continue
    pen.fillStyle = colour(TONES[LOUD[one.importance]] ?? '--soft')
    pen.beginPath()
    pen.moveTo(at - 5 * ratio, top)
    pen.lineTo(at + 5 * ratio, top)
    pen.lineTo(at, top + 9 * ratio)
    pen.fill()
  }
  pen.restore()
}
