// Quantities of the live frames: what the promoted nets of a position, pattern, count or force answer. The page Live
// shows them while such a net serves.

import { socket } from './api.js'
import { changing } from './changing.js'
import { el, panel, replacing, say } from './dom.js'
import { count, fixed } from './format.js'
import { servedQuantities } from './serves.js'

const STALE_MS = 2000

const place = ([x, y]) => `${fixed(x, 1)}, ${fixed(y, 1, 'mm')}`
const places = found => found.map(place).join('; ') || 'none'

/** Why an answer to the live frames is not sure: { tone, words }, null if it is. `who` answers. */
export function doubt(answer, old, who) {
  if (!answer) return { tone: 'soft', words: 'No answer yet: frames come while the rig is connected.' }
  if (answer.error) return { tone: 'bad', words: `${who} failed: ${answer.error}` }
  if (old) return { tone: 'warn', words: 'Outdated: no answer for some seconds.' }
  return answer.outside?.length ? { tone: 'warn', words: `Unsure: ${answer.outside.join('; ')}.` } : null
}

/** Makes the panel. `follow(serving)` opens the stream while a net of a quantity serves; `tell()` shows the newest answer. */
export function quantityPart({ signal }) {
  const numbers = el('div'), sure = el('p', { className: 'soft' })
  const node = panel('Quantities', { className: 'live', hidden: true }, numbers, sure)
  const listening = replacing(signal)
  let newest = null, at = 0

  function follow(serving) {
    const isServed = servedQuantities(serving).length > 0
    if (isServed !== node.hidden) return
    node.hidden = !isServed
    newest = null
    const until = listening()
    if (!isServed) return
    socket('/live/quantities', { signal: until, raw: true, rest: true, onmessage(text) {
      if (until.aborted) return
      newest = text
      at = Date.now()
    } })
  }

  function tell() {
    if (node.hidden) return
    const answer = newest && JSON.parse(newest), old = answer && Date.now() - at > STALE_MS
    // After an error, and until the next answer, the numbers are those of an earlier frame.
    numbers.classList.toggle('old', Boolean(!answer || answer.error || old))
    say(sure, doubt(answer, old, 'The nets')?.words)
    if (!answer || answer.error) return
    changing(numbers, [
      answer.position_mm && ['Position', place(answer.position_mm)],
      answer.pressed_mm && ['Pressed places', places(answer.pressed_mm)],
      answer.count != null && ['Number', count(answer.count)],
      answer.force_n != null && ['Sum of forces', fixed(answer.force_n, 1, 'N')],
    ])
  }
  return { node, follow, tell }
}
