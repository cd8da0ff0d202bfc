// The state of rig and run as all pages share it: one socket, or polling where there is none.
// Old is known to be old: `live.fresh` is false within 3 s after the last answer, and while answers come late.

import { Stopped, ask, door, get, person, socket } from './api.js'
import { onBeat, sleep } from './dom.js'
import { KEPT_MINUTES, addSamples, fillSamples, lastAt, samples } from './samples.js'

const OLD_MS = 2600, LATE_MS = 1500, CALLER_MS = 3000, TELL_MS = 240, STILL_MS = 600

// A change of these is told at once; other values four times per second, since faster cannot be read.
const urgent = ({ rig, run, lock, needs }) => [rig.state, rig.trip?.detail, needs.map(need => need.words), rig.stopping, rig.estop_acknowledged_ms, rig.safe_end?.tips, run?.uid, run?.state, run?.requested_state, run?.paused_why, run?.waiting_for, lock?.holder].join()

/** The newest status; dispatches `status`, `samples`, `fresh` and `caller`. */
class Live extends EventTarget {
  /** Body of `GET /status`; null before the first one. */
  status = null
  /** Whether a status came within the last 3 s, and in time. */
  fresh = false
  /** Time of the newest status, ms. */
  at = 0
  /** Why there is no fresh status. */
  why = ''
  /** Name and role of the caller; null while unknown. */
  caller = null
  /** Homing or jog in progress, or null. The jogs of a held button follow one another: they are shown as one. */
  motion = null

  #told = 0
  #timer = 0
  #urgent = ''
  #moved = { motion: null, state: '', at: 0 }

  /** Calls `then` now and on each change, until `signal` aborts. */
  on(kind, then, signal) {
    this.addEventListener(kind, () => then(this), { signal })
    if (this.status || kind === 'fresh') then(this)
  }

  /** Calls `then` when what `of(status)` returns differs from that of the status before, until `signal` aborts. */
  onChange(of, then, signal) {
    let before = null
    this.on('status', ({ status }) => {
      const now = of(status)
      if (before != null && now !== before) then()
      before = now
    }, signal)
  }

  /** Whether the caller may do what needs this role. */
  may(role) {
    const order = ['viewer', 'operator', 'admin']
    return order.indexOf(this.caller?.role ?? 'viewer') >= order.indexOf(role)
  }

  take(status) {
    this.status = status
    this.at = Date.now()
    this.state(true, '')
    const { motion, state } = status.rig, before = this.#moved
    if (motion) this.#moved = { motion, state, at: this.at }
    this.motion = motion ?? (before.state === state && Math.abs(this.at - before.at) < STILL_MS ? before.motion : null)
    if (!this.caller && this.at - callerAsked > CALLER_MS) caller()
    const now = urgent(status) + this.motion
    if (now !== this.#urgent) { this.#urgent = now; this.#tell() } else this.#timer ||= setTimeout(this.#later, this.#told + TELL_MS - this.at)
  }
  #tell = () => {
    clearTimeout(this.#timer)
    this.#timer = 0
    this.#told = Date.now()
    this.dispatchEvent(new Event('status'))
  }
  #later = onBeat(this.#tell)

  state(fresh, why) {
    const changed = this.fresh !== fresh || this.why !== why
    this.fresh = fresh
    this.why = why
    if (changed) this.dispatchEvent(new Event('fresh'))
  }
}
export const live = new Live()

function take(more) {
  if (!addSamples(more)) return
  samples.arrived_ms = Date.now()
  live.dispatchEvent(new Event('samples'))
}

let callerAsked = 0
async function caller(signal) {
  callerAsked = Date.now()
  try {
    live.caller = await get('/caller', {}, { signal })
    live.dispatchEvent(new Event('caller'))
  } catch { /* A page without it offers what a viewer may do; asked again with a status. */ }
}

function lost(error) {
  if (error instanceof Stopped) return // The next reading shows whether there is a connection.
  live.state(false, error?.status === 401 ? 'No status without a key that is valid' : error?.status ? `No status (${error.message})` : 'No connection')
}

async function poll(signal) {
  for (let begun; !signal.aborted; await sleep(Math.max(100, begun + 500 - Date.now()), signal)) {
    begun = Date.now()
    if (Math.abs(begun - socketAt) < 2000) continue
    try {
      const status = await (await ask('/api/v1/status', { wait: 2000 })).json()
      ahead = begun - Date.parse(status.at)
      live.take(status)
    } catch (error) { lost(error) }
  }
}

// At most the time by which this computer's clock is ahead of the service's, ms: a status was made after it was asked for.
// By it a message of the socket that a slow network held back is late, and polls replace it. So they do if a clock was set.
let ahead = -Infinity
let socketAt = 0
async function listen(signal) {
  // Without a socket no samples come: those after `since` are read once it is open again.
  let since = lastAt() ?? 0, whole = false, asked = false
  const read = async () => {
    asked = true
    try {
      const more = await get('/rig/samples', { minutes: KEPT_MINUTES }, { signal })
      whole = true
      if (fillSamples(more, since)) live.dispatchEvent(new Event('samples'))
    } catch { /* Read with the next opening. */ }
  }
  await read()
  asked = whole
  socket('/status/live', {
    signal,
    onstate(open) {
      if (open && !asked) read()
      if (open) return
      if (whole) since = lastAt() ?? 0
      whole = asked = false
    },
    onmessage(message) {
      const behind = Date.now() - Date.parse(message.status.at)
      ahead = Math.min(ahead, behind)
      const isLate = behind - ahead > LATE_MS
      socketAt = isLate ? 0 : Date.now()
      take(message.samples)
      if (!isLate) live.take(message.status)
    },
  })
}

/** Starts; a new key starts again. */
export function start() {
  let ending = new AbortController()
  const begin = () => {
    ending.abort()
    ending = new AbortController()
    socketAt = 0
    for (const run of [caller, poll, listen]) run(ending.signal)
  }
  door.addEventListener('key', () => { live.caller = null; begin() })
  // Either way: a clock that is set back must not make an old status a fresh one.
  setInterval(() => { if (live.fresh && Math.abs(Date.now() - live.at) > OLD_MS) lost() }, 250)
  begin()
}

/** Label of what this rig measures, for its pictures; '' while it is not known. */
export const rigLabel = () => live.status?.rig.label ?? ''

/** Name for the log of actions; a remembered one, else that of the key. */
export const who = () => person.name || live.caller?.name || ''
