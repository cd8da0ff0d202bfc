// A recording of the live raw frames: kept in this browser beyond a reload, bounded, counted, saved as NDJSON or CSV.
// The service stores trials alone: frames without a known contact have no place there.

import { confirm, outcome } from './actions.js'
import { socket } from './api.js'
import { button, download, el, fill, panel, say } from './dom.js'
import { bytes, clock, count, countOf, moment, span } from './format.js'
import { MOST, NOTHING, frameStore } from './framestore.js'
import { live } from './live.js'
import { speak } from './speak.js'

// A part is stored after this number of frames or this time, whichever comes first: what a crash may lose.
const PART_FRAMES = 60
const PART_MS = 1000
const SHOW_MS = 250

/** Frames that were received and are not stored yet, all of one label and size. */
function partial(label, channels) {
  return { label, channels, missed: 0, at: [], sequence: [], device_time_us: [], voltages_v: new Float32Array(PART_FRAMES * channels) }
}
const whole = part => ({ ...part, voltages_v: part.voltages_v.slice(0, part.at.length * part.channels) })

const number = v => (Number.isNaN(v) ? null : Number(v.toPrecision(9)))
const HEADS = ['at', 'label', 'sequence', 'device_time_us']
const rowOf = (part, i) => [new Date(part.at[i]).toISOString(), part.label, part.sequence[i], part.device_time_us[i]]
const voltsOf = (part, i) => Array.from(part.voltages_v.subarray(i * part.channels, (i + 1) * part.channels), number)

/** Formats of the file: its end, its type, its head, and the line of one frame of a part. */
const FORMATS = {
  NDJSON: ['ndjson', 'application/x-ndjson', () => '', (part, i) => {
    const [at, label, sequence, device_time_us] = rowOf(part, i)
    return JSON.stringify({ at, label: label || null, sequence, device_time_us, voltages_v: voltsOf(part, i) })
  }],
  CSV: ['csv', 'text/csv', kept => `${[...HEADS, ...Array.from({ length: kept.channels }, (_, i) => `v${i}_v`)].join()}\n`, (part, i) =>
    [...rowOf(part, i), ...voltsOf(part, i).map(v => v ?? '')].join()],
}

/** Makes the panel; the recording ends with `signal`, when the page is left. What is kept stays. */
export function recorder({ signal }) {
  let store = null, kept = NOTHING, part = null, last = null, cut = null, shown = 0, begun = 0, writing = Promise.resolve()
  const said = outcome(), words = el('p', { className: 'hold' }), bar = el('progress',
    { max: MOST, value: 0, 'aria-label': `Frames kept, of the ${count(MOST)} that this browser keeps` })
  const about = el('p', { className: 'soft small' }), row = el('div', { className: 'row' })
  const node = panel('Record', {}, about, bar, words, row, said.node)
  const waiting = () => part?.at.length ?? 0
  const label = () => live.status?.rig.label ?? ''

  function take(text) {
    const frame = JSON.parse(text), volts = frame.voltages_v
    if (frame.sequence === last) return
    if (part && (part.channels !== volts.length || part.label !== label())) write()
    if (!part) { part = partial(label(), volts.length); begun = Date.now() }
    if (last != null && frame.sequence > last + 1) part.missed += frame.sequence - last - 1
    last = frame.sequence
    const i = part.at.push(Date.now()) - 1
    part.sequence.push(frame.sequence)
    part.device_time_us.push(frame.device_time_us)
    for (let k = 0; k < volts.length; k += 1) part.voltages_v[i * volts.length + k] = volts[k] ?? NaN
    if (i + 1 === PART_FRAMES || Date.now() - begun > PART_MS) write()
    if (Date.now() - shown > SHOW_MS) tell()
  }

  /** Stores what waits; one part after the other. */
  function write() {
    if (!waiting()) return
    const one = whole(part)
    part = null
    writing = writing.then(async () => {
      try { kept = await store.add(one) } catch (error) {
        stop()
        said.tell(`${count(one.at.length)} frames could not be kept (${error.message}): the recording is stopped. `
          + 'Save what is kept, discard it, and record again.', 'bad')
      }
      if (kept.frames >= MOST && cut) stop()
      tell()
    })
  }

  function begin() {
    last = null // Frames between two recordings are not missed.
    cut = new AbortController()
    const until = AbortSignal.any([signal, cut.signal])
    said.tell('')
    let comes = true
    socket('/frames/live', { signal: until, raw: true, onmessage: text => until.aborted || take(text), onstate(open) {
      if (until.aborted || open === comes) return
      comes = open
      said.tell(open ? '' : 'No frames come: the connection is tried again.', 'warn')
    } })
    offer()
    speak('Recording.')
  }
  function stop() {
    cut?.abort()
    cut = null
    write()
    offer()
    if (!signal.aborted) writing.then(() => speak(words.textContent.trim()))
  }

  function tell() {
    shown = Date.now()
    const frames = Math.min(MOST, kept.frames + waiting())
    bar.value = frames
    if (!frames) return say(words, cut ? 'Waiting for the first frame.' : 'Nothing is kept.')
    const from = kept.from ?? part.at[0], to = part?.at.at(-1) ?? kept.to
    const missed = kept.missed + (part?.missed ?? 0)
    return say(words, [`${countOf(frames, MOST)} frames are kept, ${bytes(kept.bytes)}, recorded ${moment(from, true)} to ${clock(to)} (${span((to - from) / 1e3)})`,
      kept.labels.includes('virtual') && 'virtual', missed > 0 && `${count(missed)} between them were not sent to this page`,
      frames >= MOST && 'no room is left', !cut && kept.saved && 'saved'].filter(Boolean).join('; ') + '.')
  }

  /** Makes a file of all that is kept, part by part: a text of 9,000 frames is 80 MB. */
  async function save(format) {
    const [extension, type, head, line] = FORMATS[format]
    await writing
    const of = await store.kept() // Frames may be added while the file is made.
    kept = of
    const texts = [head(of)]
    await store.each(one => texts.push(new Blob([one.at.map((_, i) => `${line(one, i)}\n`).join('')])))
    if (!of.frames) throw new Error('another tab has discarded the frames')
    download(`frames-${of.labels.join('-') || 'unknown'}-${new Date(of.from).toISOString().slice(0, 19).replaceAll(':', '')}.${extension}`,
      new Blob(texts, { type }))
    await store.markSaved(of)
    kept = await store.kept()
    offer()
  }
  async function discard() {
    const sure = kept.saved || await confirm(`Discard ${count(kept.frames)} frames?`, 'They were not saved as a file. They cannot be restored.', 'Discard')
    if (!sure) return
    await said.run('Discard the frames', async () => { await writing; await store.clear(); kept = await store.kept() })
    offer()
  }

  function offer() {
    tell()
    const saving = format => button(`Download ${format}`, () => said.run(`Download ${format}`, () => save(format)))
    const full = kept.frames >= MOST
    fill(row, cut ? button('Stop recording', stop) : [!full && button(kept.frames ? 'Continue recording' : 'Record', begin, { disabled: !store }),
      kept.frames > 0 && [saving('NDJSON'), saving('CSV'), button('Discard', discard, { className: 'plain' })]])
  }

  // Asked only where something would be lost: what is not stored yet. For frames in memory alone, the store asks.
  addEventListener('beforeunload', event => {
    if (waiting()) event.preventDefault()
    write() // While the browser asks, this is stored.
  }, { signal })
  // Another tab may have recorded or discarded meanwhile.
  document.addEventListener('visibilitychange', async () => { if (store && !document.hidden && !cut) { kept = await store.kept(); if (!cut) offer() } }, { signal })
  signal.addEventListener('abort', stop)
  frameStore().then(async found => {
    store = found
    kept = await store.kept()
    say(about, `Keeps the raw frames in this browser, at most ${count(MOST)}. ${store.isLasting ? 'A reload and other pages leave them here, until you discard them.'
      : 'This browser keeps them in this tab alone: a reload loses them.'} A recording ends when you leave this page. Nothing is stored by the service.`)
    offer()
  }).catch(error => said.tell(`The frames of this browser cannot be read: ${error.message}.`, 'bad'))
  offer()
  return node
}
