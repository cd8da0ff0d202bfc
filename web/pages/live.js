// Live: what is touching the skin? Contacts of the live frames at up to 30 per second, how sure they are, which
// model answers; quantities by promoted nets; a recording of the raw frames. Its address: method, scale, zoom-total, record-frames, record-format.

import { get, socket } from '../lib/api.js'
import { changing } from '../lib/changing.js'
import { chart } from '../lib/chart.js'
import { el, every, fill, panel, replacing, say, select } from '../lib/dom.js'
import { count, counted, countOf, fixed, listed } from '../lib/format.js'
import { roundUp } from '../lib/frame.js'
import { live, rigLabel } from '../lib/live.js'
import { missingOf } from '../lib/missing.js'
import { doubt, quantityPart } from '../lib/quantities.js'
import { recorder } from '../lib/recording.js'
import { bestMethod, lacks, needWords, servingPart } from '../lib/serves.js'
import { sensor } from '../lib/skin.js'
import { table } from '../lib/table.js'
import { numbered, touchMap } from '../lib/touchmap.js'
import { vocabulary } from '../lib/vocabulary.js'

const SCALES = [['5', '5 N'], ['20', '20 N'], ['', '50 N'], ['100', '100 N']]
// Answers that may wait for their drawing; the service sends at most that many together.
const LATE = 5
const FRAME_US = 33_333 // Of a board.
const TELL_MS = 250, TRACE_MS = 100, TRACED = 600, SERVING_MS = 10_000, STALE_MS = 2000

/** How sure an answer is: { tone, words }. */
function sureness(answer, old) {
  const unsure = doubt(answer, old, 'The method')
  if (unsure) return unsure
  const misfit = answer.misfit == null ? '' : ` The fit leaves ${fixed(answer.misfit, 1)} times the noise (limit ${answer.misfit_limit}).`
  const notes = (answer.notes ?? []).map(note => ` Note: ${note}.`).join('')
  const found = answer.contacts.length ? counted(answer.contacts.length, 'contact') : 'Nothing touches the skin', others = answer.alternatives ?? []
  const why = others.some(other => other.probability > answer.probability) ? ' (the number of contacts is the most probable one)' : ''
  if (others.length) return { tone: 'warn', words: `${found}, with a probability of ${fixed(100 * answer.probability, 0, '%')}${why}. Other explanations: ${others.map(explained).join('; ')}.${misfit}${notes}` }
  return { tone: notes ? 'warn' : 'good', words: `${found}.${misfit}${notes}` }
}

/** Another explanation of a frame. */
const explained = ({ probability, contacts }) => `${contacts.length ? counted(contacts.length, 'contact') : 'no contact'}, ${fixed(100 * probability, 0, '%')}`

/** Shows the page. */
export async function show(root, { query, signal, set }) {
  let state = query, serving = null, open = '' // The method of the socket.
  let waiting = [], answer = null, at = 0, asked = false // Messages that are not drawn yet, and what was drawn.
  let tabled = '', arrived = 0, drawings = 0, told = { arrived: 0, drawings: 0 }, since = performance.now(), rates = {}
  let heard = null // Frame counter of the newest drawn answer, and how many had arrived with it.
  const listening = replacing(signal), latencies = [], lost = missingOf(), trace = { at: [], total: [], from: 0 }
  const chosen = () => vocabulary.methods.find(one => one.name === state.method) ?? bestMethod(serving)

  const map = touchMap({ signal, label: rigLabel, query: '/api/v1/serving' })
  const scales = select(SCALES, state.scale ?? '', value => set({ scale: value }), { 'aria-label': 'Force at the end of the colours' })
  const methods = select([['', 'Best that serves'], ...vocabulary.methods.map(one => [one.name, one.name])], state.method ?? '', value => set({ method: value }),
    { 'aria-label': 'Method' })
  const sure = el('p', { className: 'answer sure' }), numbers = el('div'), serves = servingPart(), quantities = quantityPart({ signal })
  const columns = [
    { head: 'Contact', cell: c => String(c.number) }, { head: 'x', unit: 'mm', cell: c => spread(c.x_mm, c.x_sd_mm) },
    { head: 'y', unit: 'mm', cell: c => spread(c.y_mm, c.y_sd_mm) }, { head: 'Force', unit: 'N', cell: c => spread(c.force_n, c.force_sd_n) },
  ]
  const presence = { head: 'Presence', unit: '%', cell: c => c.presence == null ? '–' : fixed(100 * c.presence, 0) }
  const [placed, proposed] = [columns, [...columns, presence]].map(columns => table({ caption: 'Contacts', empty: 'Nothing touches the skin.', columns }))
  const lists = el('div')
  const total = chart({ title: 'Total force, last minute', key: 'total', y: 'Force', unit: 'N', height: 130, signal, label: rigLabel,
    series: [{ name: 'total', digits: 1, fill: true }], range: (_, high) => [0, roundUp(Math.max(5, high || 0))] })
  const now = panel('Now', { className: 'live touch', aside: methods }, sure, numbers, lists)
  const colours = el('label', { className: 'inline' }, 'Colours up to', scales)
  const picture = el('section', { className: 'live' }, el('div', { className: 'row tight' }, colours), map.node)
  const touched = el('section', { className: 'live touched' }, total.node)
  const beside = el('div', { className: 'column' }, now, touched, quantities.node, serves.node, recorder({ signal }))
  const page = el('div', { className: 'columns live-columns' }, picture, beside)
  fill(root, serves.none, page)

  // One socket for the chosen method; the map is asked for where the contacts do not say it all.
  function listen() {
    const method = chosen(), ready = method && !lacks(method, serving).length, wanted = ready ? method.name : ''
    if (wanted === open) return
    open = wanted
    const until = listening()
    answer = heard = null
    waiting = []
    lost.clear()
    map.show(null)
    if (!wanted) return
    socket('/live', { signal: until, raw: true, rest: true, query: { method: wanted, map: method.uses.includes('map') || null }, onmessage(text) {
      if (until.aborted) return
      waiting.push(text)
      if (waiting.length > LATE) waiting = [text]
      arrived += 1
      ask()
    } })
  }

  // One drawing per picture of the screen: answers that arrive together are drawn one after the other. What comes too
  // late to be drawn is not even read.
  function ask() { if (!asked) { asked = true; requestAnimationFrame(frame) } }
  function frame() {
    asked = false
    if (signal.aborted || !waiting.length) return
    drawings += 1
    const read = JSON.parse(waiting.shift())
    at = Date.now()
    heard = { sequence: read.sequence, arrived: arrived - waiting.length }
    if (read.error) { answer = { ...read, contacts: [] } } else {
      numbered(read.contacts, answer?.contacts ?? [])
      answer = read
      latencies.push(read.latency_us)
      if (latencies.length > 60) latencies.shift()
      keep(read)
    }
    map.show(answer)
    if (waiting.length) ask() // After the map has asked for its picture, so that this one is drawn before the next.
  }

  function keep({ contacts }) {
    if (at - trace.from < TRACE_MS) return
    trace.from = at
    let sum = 0
    for (const contact of contacts) sum += contact.force_n ?? 0
    trace.at.push(at / 1e3)
    trace.total.push(sum)
    if (trace.at.length > TRACED) { trace.at.shift(); trace.total.shift() }
  }

  // Words and numbers four times per second: faster cannot be read.
  function tell() {
    const old = answer && Date.now() - at > STALE_MS, method = chosen(), words = open || !serving ? sureness(answer, old) : missing(method)
    say(sure, words.words)
    sure.className = `answer sure ${words.tone}`
    for (const part of [picture, numbers, lists, touched]) part.classList.toggle('old', Boolean(old))
    const seconds = (performance.now() - since) / 1e3
    if (seconds >= 1) {
      const sorted = [...latencies].sort((a, b) => a - b), latency = sorted[sorted.length >> 1]
      const per = name => { const now = { arrived, drawings }[name]; return `${fixed((now - told[name]) / seconds, 0)} per s` }
      rates = { isSlow: latency > FRAME_US, latency: latency == null || old ? '–' : fixed(latency / 1e3, 1, 'ms'), answers: per('arrived'), drawn: per('drawings') }
      told = { arrived, drawings }
      if (heard && !old) lost.add({ ...heard, missed: live.status?.rig.stream.missed ?? 0 })
      Object.assign(page.dataset, { arrived, drawn: drawings }) // For those who count them.
      since = performance.now()
    }
    numbers.hidden = lists.hidden = !answer
    const sum = answer?.contacts.reduce((newtons, c) => newtons + (c.force_n ?? 0), 0)
    if (answer) changing(numbers, [
      ['Contacts', String(answer.contacts.length)], ['Total force', fixed(sum, 1, 'N')],
      answer.averaged != null && ['Averaged', counted(Math.round(answer.averaged), 'frame')],
      ['Latency', rates.latency], ['Answers', rates.answers], ['Drawn', rates.drawn],
      // A rig that is faster than the clock sends more than anyone can look at.
      live.status?.rig.clock_rate <= 1 && ['Missing, last minute', missingWords(lost.last(), rates.isSlow)],
    ])
    const list = answer?.contacts.some(contact => contact.presence != null) ? proposed : placed
    if (lists.firstChild !== list.node) fill(lists, list.node)
    const contacts = [...answer?.contacts ?? []].sort((a, b) => a.number - b.number)
    const text = JSON.stringify([list === proposed, contacts])
    if (text !== tabled) { tabled = text; list.show(contacts) }
    if (trace.at.length > 5) total.set([trace.at, trace.total])
    quantities.tell()
  }
  const missing = method => method ? { tone: 'warn', words: `${method.name} ${needWords(method, serving)} that serves.` }
    : { tone: 'soft', words: 'No model for contacts serves: they cannot be estimated.' }

  function tellServing() {
    serves.show(serving)
    page.classList.toggle('waiting', !bestMethod(serving))
    const best = bestMethod(serving)?.name
    say(methods.options[0], best ? `Best that serves (${best})` : 'Best that serves')
  }

  map.scale(Number(state.scale) || 50)
  every(SERVING_MS, async () => {
    try {
      serving = await get('/serving', {}, { signal })
      tellServing()
      listen()
      quantities.follow(serving)
    } catch (error) { if (!signal.aborted) serves.failed(error) }
  }, signal)
  const timer = setInterval(() => { if (!document.hidden) tell() }, TELL_MS)
  signal.addEventListener('abort', () => clearInterval(timer))
  tell()
  try { map.geometry(await sensor()) } catch (error) { picture.prepend(el('p', { className: 'bad' }, `The skin cannot be drawn: ${error.message}`)) }

  return {
    update(next) {
      state = next
      methods.value = state.method ?? ''
      scales.value = state.scale ?? ''
      map.scale(Number(state.scale) || 50)
      listen()
      tell()
    },
  }
}

/** How many frames are missing in the answers, and why: the method is slow, or the service did not receive them. */
function missingWords(last, isSlow) {
  if (!last) return '–'
  if (!last.missing) return 'none'
  const why = [isSlow && 'an answer takes longer than a frame', last.unreceived && `${count(last.unreceived)} not received from the rig`]
  return listed([`${countOf(last.missing, last.frames)} frames`, ...why])
}

/** A value with its standard deviation, where there is one. */
function spread(value, sd) {
  if (value == null || sd == null) return fixed(value, 1)
  return el('span', { className: 'nowrap' }, `${fixed(value, 1)} ± ${fixed(sd, 1)}`)
}
