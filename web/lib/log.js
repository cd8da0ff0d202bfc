// The event log: newest first, important events marked, followed live.

import { follow, get } from './api.js'
import { el, every, onBeat, panel, say, select } from './dom.js'
import { clock, day } from './format.js'
import { vocabulary } from './vocabulary.js'
import { LOUD } from './words.js'

const KEPT = 400, SHOWN = 80
const LONG_MS = 18 * 3_600_000, DATES_MS = 600_000
const FOLLOWED = -200 // The newest of all, then each as it comes.
/** Whether a person must not miss an event. */
export const matters = event => event.importance !== 'routine'
/** Kinds of which some events matter, as a parameter of a request. */
export const kindsThatMatter = () => vocabulary.events.filter(matters).map(({ name }) => name).join()

const isLongAgo = event => Date.now() - Date.parse(event.at) >= LONG_MS
/** An event as a row of a list: its time, with the day if it is long ago, and its words. */
export const eventRow = event => el('li', { className: LOUD[event.importance] ?? '', data: { old: isLongAgo(event) } },
  el('time', { dateTime: event.at, title: `${day(event.at)} ${clock(event.at)}` }, isLongAgo(event) ? `${day(event.at)} ${clock(event.at).slice(0, 5)}` : clock(event.at)),
  el('span', {}, event.words))

/** The choice between important events and all; `state.log` is 'all' or absent. */
export const eventChoice = (state, set) => select([['', 'Only important ones'], ['all', 'All events']], state.log ?? '', log => set({ log: log || null }),
  { 'aria-label': 'Which events' })

/** Makes the log. `state.log` is 'all' or absent (only important ones). */
export function eventLog({ state, set, signal }) {
  let made = new Map(), important = [], lacks = '', cut = '' // Those that matter, further back than the newest of all; what is not known, and whether the stream is cut.
  const kept = [], list = el('ol', { className: 'events scroll', tabIndex: 0, 'aria-label': 'Events, newest first' }), line = el('p',
    { className: 'soft small' })
  const choice = eventChoice(state, set)
  const draw = onBeat(() => {
    const wanted = state.log === 'all' ? kept : important, last = wanted.slice(-SHOWN).reverse()
    // A row is made once, and again when its time needs the day: events come every second, and a list of new rows each time is garbage.
    const rows = last.map(event => (made.get(event)?.dataset.old === String(isLongAgo(event)) ? made.get(event) : eventRow(event)))
    made = new Map(last.map((event, i) => [event, rows[i]]))
    rows.forEach((node, i) => { if (list.children[i] !== node) list.insertBefore(node, list.children[i] ?? null) })
    while (list.children.length > rows.length) list.lastChild.remove()
    if (cut) say(line, cut)
    else if (lacks && state.log !== 'all') say(line, lacks)
    else if (last.length) say(line, wanted.length > SHOWN ? `The newest ${SHOWN} events.` : '')
    else say(line, kept.length ? 'No important events. Select “All events” to see every one.' : 'No events yet.')
  })
  follow(FOLLOWED, {
    signal,
    onstate(open) {
      cut = open ? '' : 'Events are not followed now: the connection is tried again.'
      draw()
    },
    onevent(event) {
      kept.push(event)
      if (kept.length > KEPT) kept.splice(0, kept.length - KEPT)
      if (matters(event) && event.seq > (important.at(-1)?.seq ?? 0)) important = [...important.slice(1 - KEPT), event]
      draw()
    },
  })
  // In a night there are far more routine events than are followed: what matters may have been hours ago.
  get('/events', { kind: kindsThatMatter(), since: -KEPT, limit: KEPT }, { signal }).then(({ items }) => {
    const known = new Set(important.map(({ seq }) => seq))
    important = [...items.filter(event => matters(event) && !known.has(event.seq)), ...important].sort((a, b) => a.seq - b.seq).slice(-KEPT)
    draw()
  }, error => {
    lacks = `Important events further back could not be read: ${error.message}.`
    draw()
  })
  every(DATES_MS, draw, signal)
  return {
    node: panel('Events', { className: 'live log', aside: choice }, list, line),
    update(next) { state = next; choice.value = state.log ?? ''; draw() },
  }
}
