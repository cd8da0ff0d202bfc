// A recording of the live raw frames: the service sends them as a file, from the press on, and this page saves it.

import { outcome } from './actions.js'
import { ask, withQuery } from './api.js'
import { button, download, el, fill, panel, say, select } from './dom.js'
import { bytes, count, countOf, listed } from './format.js'
import { keepForm } from './formstate.js'
import { live } from './live.js'
import { speak } from './speak.js'
import { vocabulary } from './vocabulary.js'

// Lengths that are offered, frames: about 10 s, a minute and five minutes of a rig that sends 30 per second.
const LENGTHS = [300, 1800, 9000]
const LINE_END = 10

/** The whole lines of a text that was cut: its bytes up to the last end of a line. */
async function wholeLines(pieces) {
  const text = new Uint8Array(await new Blob(pieces).arrayBuffer())
  return [text.subarray(0, text.lastIndexOf(LINE_END) + 1)]
}
const ends = piece => piece.reduce((sum, byte) => sum + (byte === LINE_END), 0)

/** Makes the panel. A recording that is cut, also by leaving the page, keeps the whole rows of a text; other formats need their end. */
export function recorder({ signal }) {
  const formats = vocabulary.formats.filter(format => format.streams)
  let cut = null
  const said = outcome(), words = el('p', { className: 'hold', hidden: true }), row = el('div', { className: 'row' })
  const length = select(LENGTHS.map(frames => [frames, `${count(frames)} frames`]), LENGTHS[0], () => {}, { id: 'record-frames', 'aria-label': 'Number of frames' })
  const format = select(formats.map(({ name, title }) => [name, title]), 'csv', () => {}, { id: 'record-format', 'aria-label': 'Format of the file' })
  const bar = el('progress', { max: 1, value: 0, hidden: true, 'aria-label': 'Frames recorded' })
  const chosen = () => formats.find(one => one.name === format.value) ?? formats[0]

  async function record() {
    const frames = Number(length.value), { name, title, extension, is_text } = chosen(), label = live.status?.rig.label ?? 'unknown'
    const at = new Date().toISOString().slice(0, 19).replaceAll(':', ''), heads = name === 'csv' ? 1 : 0
    let pieces = [], size = 0, lines = 0, rows = 0, failure = null
    const sum = () => listed([is_text && countOf(rows, frames), bytes(size), label])
    cut = new AbortController()
    Object.assign(bar, { max: frames, value: 0, hidden: !is_text })
    said.tell('')
    say(words, 'Waiting for the first frame …').hidden = false
    offer()
    speak('Recording.')
    try {
      const until = AbortSignal.any([signal, cut.signal])
      const { body } = await ask(withQuery('/api/v1/frames/recording', { frames, format: name }), { accept: '*/*', wait: 0, signal: until })
      for (const reader = body.getReader(); ;) {
        const { done, value } = await reader.read()
        if (done) break
        pieces.push(value)
        size += value.length
        // The head of a table may come in several pieces.
        if (is_text) bar.value = rows = Math.max(0, (lines += ends(value)) - heads)
        say(words, `Frames: ${sum()}.`)
      }
    } catch (error) { failure = error }
    const isStopped = cut.signal.aborted || signal.aborted, isSaved = is_text ? rows > 0 : !failure
    if (isSaved && failure) pieces = await wholeLines(pieces)
    if (isSaved) download(`frames-${label}-${at}.${extension}`, new Blob(pieces))
    cut = null
    bar.hidden = words.hidden = true
    const why = failure?.status ? `Not recorded: ${failure.message}.` : failure && !isStopped ? `The recording was cut: ${failure.message}.` : ''
    const what = isSaved ? `Frames saved: ${sum()}.` : failure?.status ? '' : is_text ? 'No frame came: nothing is saved.'
      : `${title} needs its end: nothing is saved.`
    said.tell(listed([why, what], ' '), failure && !isStopped ? 'bad' : isSaved && !why ? 'good' : 'warn')
    offer()
  }

  function offer() {
    const hadFocus = row.contains(document.activeElement)
    for (const node of [length, format]) node.disabled = Boolean(cut)
    fill(row, length, format, cut ? button(chosen().is_text ? 'Stop and save' : 'Stop and discard', () => cut?.abort()) : button('Record', record))
    if (hadFocus) row.lastChild.focus()
  }

  addEventListener('beforeunload', event => { if (cut) event.preventDefault() }, { signal })
  keepForm([length, format], { signal })
  offer()
  return panel('Record', {}, el('p', { className: 'soft small' }, 'The service sends the raw frames from the press on, and this page saves them as a file; '
    + 'the service keeps none. In the terminal: ', el('code', {}, 'palpate live --record FILE --frames N'), '.'), row, bar, words, said.node)
}
