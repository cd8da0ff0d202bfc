// How a run begins: wires, homing, arming, start. The queue and the night begin runs here.
// The service asks for two steps, arming and starting, so that a person sees the preflight between them.

import { actOnRig, actOnRun, actor, confirm, named, runRefusal } from './actions.js'
import { Unanswered, once, send } from './api.js'
import { carriedItem } from './carried.js'
import { el, facts, say } from './dom.js'
import { bytes, capital, count, counted, moment } from './format.js'
import { live, who } from './live.js'
import { band } from './preflight.js'

const CONNECT_S = 30, HOME_S = 180
const beginning = new Set() // Runs that are being begun: a list may be drawn again meanwhile, with a new button.

/** Resolves when the status meets `test`; rejects after `seconds`, if the rig trips, or once its motion was ended. */
function until(test, seconds, what) {
  let moved = false
  return new Promise((resolve, reject) => {
    const cut = new AbortController()
    const end = error => { cut.abort(); clearTimeout(timer); error ? reject(error) : resolve() }
    const timer = setTimeout(() => end(new Error(`${what} took more than ${seconds} s`)), 1e3 * seconds)
    live.on('status', ({ status, motion }) => {
      if (test(status)) queueMicrotask(end)
      else if (status.rig.trip) queueMicrotask(() => end(new Error(`the rig tripped: ${status.rig.trip.detail}`)))
      else if (moved && !motion) queueMicrotask(() => end(new Error(`${what} was ended early`)))
      moved ||= Boolean(motion)
    }, cut.signal)
  })
}

/** Connects and homes the rig if its state needs it; `step` is told what is being done. */
async function readyRig(step = () => {}) {
  const state = () => live.status?.rig.state, refused = live.status && runRefusal(live.status, 'start')
  if (live.status?.run) {
    if (refused) throw new Error(refused)
    return // A run holds the rig: what is started now waits for its end.
  }
  // The service would begin a run of weights on a skin alone that has tripped: its cause is cleared first.
  if (state() === 'tripped') throw new Error(refused || 'the rig is tripped: clear the cause, reset it first')
  if (state() === 'disconnected') {
    step('Opening the wires')
    await actOnRig('connect')
    await until(({ rig }) => rig.state !== 'disconnected', CONNECT_S, 'connecting')
  }
  if (state() === 'disarmed' && live.status.rig.has_stage !== false) {
    step('Homing the axes')
    await actOnRig('home')
    await until(({ rig }) => rig.state === 'homed', HOME_S, 'homing')
  }
}

/** Asks before a real rig is readied, if that moves or opens anything; resolves to whether it may be. */
function mayReady({ rig, run }, title) {
  const closed = rig.state === 'disconnected', homes = rig.has_stage !== false && (closed || rig.state === 'disarmed')
  if (run || rig.label === 'virtual' || !homes) return true
  const words = `${closed ? 'The wires are opened, then the axes are homed' : 'The axes are homed'}: they move. Keep hands and tools away from the rig.`
  return confirm(`Ready the rig for ${title}?`, [words, 'Then the run is checked, and you are asked again before it starts.'], closed ? 'Open and home' : 'Home')
}

/** What a preflight says, for the person who starts the run. */
function preflightWords(preflight) {
  const { trials, duration_s, duration_low_s, duration_high_s, waits_for_person, disk_bytes } = preflight
  return [
    facts([['Trials', count(trials)], ['Duration', band(duration_s, duration_low_s, duration_high_s)], ['Disk', bytes(disk_bytes)]]),
    waits_for_person ? `It waits for a person ${counted(waits_for_person, 'time')}: tips to change, or weights to place.` : 'It needs no person until its end.',
  ]
}

/** Who may start a run: { tone, words } for this caller, while the operator lock is free or taken. */
function startWords(caller, lock) {
  if (lock && lock.holder === caller?.name) return { tone: 'soft', words: 'You have the operator lock: others cannot start a run until you release it.' }
  if (lock) return { tone: 'warn', words: `${lock.holder} has the operator lock since ${moment(lock.since)}: ${lock.note}. Others cannot start a run until it is released.` }
  if (!caller) return { tone: 'soft', words: 'Runs are started by callers with the role operator or admin.' }
  return caller.role === 'viewer' ? { tone: 'warn', words: 'You may watch, pause and stop. Starting a run needs a key with the role operator: see the settings.' }
    : { tone: 'soft', words: `You may start runs${caller.name ? ` as ${caller.name}` : ''} (role ${caller.role}), as may every operator. Viewers may watch, pause and stop.` }
}

/** Makes the line that says who may start a run; it follows the caller and the lock. */
export function startRights(signal) {
  const node = el('p', { className: 'said' })
  const tell = () => {
    const { tone, words } = startWords(live.caller, live.status?.lock)
    say(node, words).className = `said small ${tone}`
  }
  live.addEventListener('caller', tell, { signal })
  live.on('status', tell, signal)
  tell()
  return node
}

/**
 * Begins a queued or interrupted run ({ uid, scan_id, experiment }): readies the rig, arms, shows the
 * preflight unless `ask` is false, starts. `said` is an `outcome()`. Resolves to 'running', 'waiting',
 * or undefined if it did not begin.
 */
export async function beginRun(run, said, { ask = true } = {}) {
  if (!await named() || beginning.has(run.uid)) return undefined
  beginning.add(run.uid)
  const title = `run ${run.scan_id}, ${run.experiment}`
  try {
    if (live.status && !await mayReady(live.status, title)) {
      said.tell('Not started. Nothing was moved.')
      return undefined
    }
    await readyRig(words => said.tell(`${words} …`))
    said.tell(`Checking ${title} …`)
    const { code, preflight } = await send(`/runs/${run.uid}/arm`, { who: who() })
    if (ask && !await confirm(`Start ${title}?`, [...preflightWords(preflight), 'The rig moves as soon as you start it.'], 'Start')) {
      said.tell('Not started. The run stays in the queue.')
      return undefined
    }
    said.tell(`Starting ${title} …`)
    const { started } = await actOnRun(run.uid, 'start', { code }) ?? {}
    said.tell(`${capital(title)} is started${started === 'waiting' ? ' and waits for its turn' : ''}.`, 'good')
    return started ?? 'running'
  } catch (error) {
    const result = error instanceof Unanswered ? 'may start, or the axes may move, late: keep clear of the rig' : 'did not start'
    if (error.name !== 'AbortError') said.tell(`${capital(title)} ${result}: ${error.message}`, 'bad')
    return undefined
  } finally { beginning.delete(run.uid) }
}

/** Makes a button that begins a run; `beginRun` tells each step and the result, `after` gets it. */
export const beginButton = (words, run, said, { after = () => {}, ...props } = {}) =>
  actor(words, { ...said, run: (_, work) => work() }, () => beginRun(run, said).then(after), props)

/** Queues an experiment, by its text; returns the run. Services that carry the sensor file need no text of it. */
export const queueText = (file, definition, more = {}) => once('/queue', { file, definition, who: who(), ...more })

/** Queues an experiment that the program carries, by name; returns the run. */
export async function queueCarried(name) {
  const { file, text } = await carriedItem(name)
  return queueText(file, text)
}
