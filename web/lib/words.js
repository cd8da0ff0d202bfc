// What states, events and phases are called in sentences. No DOM.

import { NONE, counted, fixed, plain } from './format.js'

/** Tone of a state: the class that colours it. */
export const TONE = { running: 'good', armed: 'good', homed: 'good', completed: 'good', success: 'good', serving: 'good', done: 'good',
  pausing: 'warn', paused: 'warn', stopping: 'warn', suspending: 'warn', interrupted: 'warn', waiting: 'warn', stopped: 'warn',
  aborting: 'bad', panicked: 'bad', tripped: 'bad', failed: 'bad', fail: 'bad', abort: 'bad' }

/** Why a run waits. */
export const WAITS = { operator: 'a person paused it', tip_change: 'tips must be changed', manual_trial: 'weights must be placed',
  suspender: 'something that watches the run suspended it', trip: 'the rig tripped', restart: 'the service was started again' }

/** What a phase does. */
export const PHASES = { next: 'selecting the next step', touch_off: 'searching for the surface', travel: 'travelling', tare: 'measuring the zeros',
  press: 'pressing', settle: 'waiting until the forces settle', measure: 'taking frames', commit: 'storing', raise: 'raising the tips', wait: 'waiting' }

/** Sentence for each state of the rig: what it is, and what follows. */
export const RIG = { disconnected: 'The wires are closed.', disarmed: 'Connected. Home the axes before anything moves.',
  homed: 'Ready.', armed: 'A run may move it.', tripped: 'Stopped by a fault. Clear the cause, reset, then home.' }

const of = t => t ? ` of configuration ${t.configuration}, depth ${t.depth_index}` : ''
const EVENTS = {
  state: d => `run ${plain(d.state)}${d.why ? ` (${WAITS[d.why] ?? plain(d.why)})` : ''}`, rig: d => `rig ${plain(d.state)}`, device: d => `${d.device}: ${plain(d.found)}`,
  wanted: d => `waits for a person: ${d.words}`, suspended: d => `suspended: ${d.why}`, trip: d => `tripped (${plain(d.kind)}): ${d.detail}`,
  attempt_failed: d => `attempt ${d.attempt}${of(d.trial)} failed: ${d.reason}`, skipped: d => `configuration ${d.configuration} skipped: ${d.reason}`,
  touch_off: d => `surface found at z = ${fixed(d.surface_z_mm, 2, 'mm')} with ${d.tips} tips`, recovering: () => 'recovering automatically',
  not_resumed: d => `not resumed: ${d.why}`, resumed: () => 'resumed after the start of the service',
  reference: d => `reference press before configuration ${d.before}`, repeat: d => `trial${of(d.trial)} is repeated: ${d.why}`,
  ended: d => `run ended, ${d.exit_status}: ${d.reason}`, tips: d => `${d.who}: ${counted(d.tips, 'tip')} mounted, ${counted(d.live_cells, 'load cell')} connected`,
  safe_end: d => d.tips === 'not_raised' ? `THE TIPS ARE NOT RAISED: ${d.why}` : `stop sent to every axis, tips ${plain(d.tips)}`,
  diary_gap: d => `${d.notes} events are missing here: they could not be stored`, store: d => `a record could not be stored: ${d.why}`,
  placed: d => `placement ${d.trial} confirmed by ${d.who}${d.verdict ? `, felt ${d.verdict}` : ''}${d.anyway ? ', stored anyway' : ''}`,
}
/** Kinds of events that an operator must not miss. */
export const LOUD = { trip: 'bad', diary_gap: 'bad', store: 'bad', not_resumed: 'bad', not_begun: 'warn', wanted: 'warn', suspended: 'warn', attempt_failed: 'warn', skipped: 'warn' }

/** Sentence of an event; an unknown kind is told by its fields. */
export function sentence({ kind, data }) {
  try {
    const words = EVENTS[kind]?.(data)
    if (words) return words
  } catch { /* A shape that this version does not know. */ }
  const fields = Object.entries(data ?? {}).filter(([, value]) => value != null && typeof value !== 'object')
  return `${plain(kind)}${fields.length ? ': ' : ''}${fields.map(([k, v]) => `${plain(k)} ${plain(v)}`).join(', ')}`
}

/** Place on the skin. */
export const at = c => c ? `x ${fixed(c.x_mm, 1)}, y ${fixed(c.y_mm, 1, 'mm')}` : NONE
