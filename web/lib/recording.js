// A recording of raw frames in this tab: bounded, counted, given away as NDJSON or CSV.
// Frames are kept as 32-bit numbers: five minutes at 30 per second take 28 MB.

import { outcome } from './actions.js'
import { socket } from './api.js'
import { button, download, el, fill, panel, say } from './dom.js'
import { bytes, count, span } from './format.js'
import { live } from './live.js'

const MOST = 9000, PART = 300, SHOW_MS = 250

/** Makes the panel; the recording ends with `signal`, when the page is left. */
export function recorder({ signal }) {
  let kept = [], cut = null, channels = 0, missed = 0, shown = 0
  const said = outcome(), words = el('p', { role: 'status' }), bar = el('progress',
    { max: MOST, value: 0, 'aria-label': 'Frames kept, of the most that this tab keeps' })
  const row = el('div', { className: 'row' })
  const node = panel('Record', {}, el('p', { className: 'soft small' },
    `Keeps the raw frames in this tab, at most ${count(MOST)}, until you leave this page. Nothing is stored by the service.`), bar, words, row, said.node)

  function take(text) {
    const frame = JSON.parse(text), last = kept.at(-1)
    if (last && frame.sequence === last.sequence) return
    if (last && frame.sequence > last.sequence + 1) missed += frame.sequence - last.sequence - 1
    channels = frame.voltages_v.length
    kept.push({ at: Date.now(), sequence: frame.sequence, device_time_us: frame.device_time_us, voltages_v: Float32Array.from(frame.voltages_v) })
    if (kept.length >= MOST) stop()
    else if (Date.now() - shown > SHOW_MS) tell()
  }
  function begin() {
    kept = []
    missed = 0
    cut = new AbortController()
    const until = AbortSignal.any([signal, cut.signal])
    socket('/frames/live', { signal: until, raw: true, onmessage: text => until.aborted || take(text),
      onstate: open => { if (!open && !until.aborted) said.tell('No frames come: the connection is tried again.', 'warn') } })
    offer()
  }
  function stop() {
    cut?.abort()
    cut = null
    offer()
  }

  function tell() {
    shown = Date.now()
    bar.value = kept.length
    bar.hidden = !cut && !kept.length
    const seconds = kept.length > 1 ? (kept.at(-1).at - kept[0].at) / 1e3 : 0
    say(words, kept.length ? [`${count(kept.length)} frames, ${span(seconds)}, ${bytes(4 * channels * kept.length)}`,
      missed > 0 && `${count(missed)} between them were not sent to this page`,
      kept.length >= MOST && 'it is full'].filter(Boolean).join('; ') + '.' : cut ? 'Waiting for the first frame.' : 'Nothing is recorded.')
  }
  const number = v => Number.isNaN(v) ? null : Number(v.toPrecision(9))
  const save = (extension, type, head, line) => {
    const parts = head ? [head] : []
    for (let i = 0; i < kept.length; i += PART) parts.push(kept.slice(i, i + PART).map(line).join(''))
    download(`frames-${live.status?.rig.label ?? 'unknown'}-${new Date(kept[0].at).toISOString().slice(0, 19).replaceAll(':', '')}.${extension}`,
      new Blob(parts, { type }))
  }
  const label = () => live.status?.rig.label ?? null
  const line = ({ at, sequence, device_time_us, voltages_v }) =>
    `${JSON.stringify({ at: new Date(at).toISOString(), label: label(), sequence, device_time_us, voltages_v: Array.from(voltages_v, number) })}\n`
  const ndjson = () => save('ndjson', 'application/x-ndjson', '', line)
  const csv = () => save('csv', 'text/csv', `at,label,sequence,device_time_us,${Array.from({ length: channels }, (_, i) => `v${i}_v`).join()}\n`,
    f => `${new Date(f.at).toISOString()},${label() ?? ''},${f.sequence},${f.device_time_us},${Array.from(f.voltages_v, v => number(v) ?? '').join()}\n`)

  function offer() {
    tell()
    fill(row, cut ? button('Stop recording', stop) : button(kept.length ? 'Record again' : 'Record', begin),
      !cut && kept.length > 0 && [button('Download NDJSON', ndjson), button('Download CSV', csv), button('Discard', () => { kept = []; offer() },
        { className: 'plain' })])
  }
  signal.addEventListener('abort', () => { kept = [] })
  offer()
  return node
}
