// The three answers of the night, from what the service reports: is it safe, is it on time, are the data good?
// Pure: facts in, { tone, words } out. `tone` is good, warn, bad, or '' where there is nothing to judge.

import { capital, count, counted, fixed, momentBand, plain, span, bytes } from './format.js'
import { WAITS, notStopped } from './words.js'

const STALE_MS = 3000, SLOW_S = 300

/** Is it safe? */
export function safe({ rig, run }) {
  const moving = notStopped(rig)
  if (moving.length) return { tone: 'bad', words: `NOT STOPPED: ${moving.join(', ')}. Use the button on the rig.` }
  if (rig.safe_end?.tips === 'not_raised') return { tone: 'bad', words: `The tips are not raised: ${rig.safe_end.why}.` }
  if (run?.state === 'panicked') return { tone: 'bad', words: 'The tips could not be raised. Check the rig.' }
  if (rig.trip) return { tone: 'bad', words: `Stopped by a fault (${plain(rig.trip.kind)}): ${rig.trip.detail}.` }
  if (rig.state === 'disconnected') return { tone: '', words: 'Nothing moves: the wires are closed.' }
  if (rig.stream.age_ms > STALE_MS) return { tone: 'warn', words: `No frame for ${span(rig.stream.age_ms / 1e3)}: check the readout.` }
  if (rig.force_limit_n == null) return { tone: 'good', words: 'No fault. This rig has no load cells and nothing that moves.' }
  const largest = Math.max(0, ...rig.forces_n.filter(f => f != null))
  return { tone: 'good', words: `No fault. Largest force now ${fixed(largest, 1, 'N')} of ${fixed(rig.force_limit_n, 0, 'N')}.` }
}

/** Is it on time? `ends` are the likely, early and late end, ms; `history` may be null, `next` is the first run of the queue. */
export function onTime({ run, not_begun }, ends, history, next) {
  if (!run && not_begun) return { tone: 'warn', words: `No run is active. ${capital(not_begun)}.` }
  if (!run && !next) return { tone: '', words: 'No run is active, and none is queued.' }
  if (!run) return { tone: '', words: `No run is active. Next: ${next.experiment}, ${counted(next.trials_planned, 'trial')}.` }
  if (run.state === 'paused' && run.paused_why) return { tone: 'warn', words: `It waits: ${WAITS[run.paused_why] ?? plain(run.paused_why)}.` }
  if (!run.eta) return { tone: '', words: 'The end is not known yet.' }
  const end = momentBand(...ends, run.eta.high_s < 900)
  const planned = history?.predicted_s == null || !history.from ? null : Date.parse(history.from) + 1e3 * history.predicted_s
  const late_s = planned == null ? null : (ends[0] - planned) / 1e3
  const than = late_s == null ? '' : Math.abs(late_s) < 60 ? ', as predicted' : `, ${span(Math.abs(late_s))} ${late_s > 0 ? 'late' : 'early'}`
  const slow = late_s != null && late_s > Math.max(SLOW_S, 0.1 * history.predicted_s)
  return { tone: slow ? 'warn' : 'good', words: `Done about ${end}${than}.` }
}

/** What the last trial alone says, where no newer trials are judged. */
function lastTrial(run, trial, suspenders) {
  if (run) return { tone: '', words: 'No twin to compare with yet.' }
  if (trial?.fvu == null) return { tone: '', words: 'Nothing to judge yet.' }
  const limits = (suspenders ?? []).filter(one => one.name === 'twin_fvu').map(one => one.threshold)
  return { tone: trial.fvu > Math.min(...limits) ? 'warn' : '', words: `The last trial has FVU ${fixed(trial.fvu, 3)}.` }
}

const WATCHED = { disk: 'free disk', frame_age: 'age of the newest frame', twin_fvu: 'fit of the twins (FVU)', electrode_pairs: 'worst electrode pair (FVU)' }

/** Name of a suspender, as text. */
export const watched = name => WATCHED[name] ?? plain(name)

/** A value of a suspender with its unit. */
export function watchedValue(value, unit) {
  if (value == null) return 'not measured'
  if (unit === 'bytes') return bytes(value)
  if (unit === 'ms' && value >= 1000) return span(value / 1e3)
  return fixed(value, unit === '1' ? 3 : Math.abs(value) < 10 ? 1 : 0, unit === '1' ? '' : unit)
}

/** Are the data good? `twins` is the body of GET /twins, `seen` what the live frames show. */
export function good({ run, disk, suspenders }, twins, seen) {
  const words = [], worse = (a, b) => ['', 'good', 'warn', 'bad'].indexOf(a) >= ['', 'good', 'warn', 'bad'].indexOf(b) ? a : b
  let tone = ''
  const over = (suspenders ?? []).filter(s => s.since)
  if (over.length) {
    tone = worse(tone, over.some(one => one.suspends) ? 'bad' : 'warn')
    words.push(`Beyond its limit: ${over.map(one => watched(one.name)).join(', ')}.`)
  }
  if (disk && disk.free_bytes < disk.needed_bytes) { tone = 'bad'; words.push(`The disk is short of ${bytes(disk.needed_bytes - disk.free_bytes)}.`) }
  const rolling = twins?.pool.rolling
  if (rolling) {
    tone = worse(tone, { ok: 'good', warn: 'warn', suspend: 'bad' }[rolling.level] ?? '')
    words.push(`FVU ${fixed(rolling.median_fvu, 3)} over ${counted(rolling.trials, 'trial')}.`)
    if (rolling.pairs_over_limit) words.push(`${counted(rolling.pairs_over_limit, 'electrode pair')} over the limit.`)
  }
  const broken = (seen.stuck?.length ?? 0) + (seen.saturated?.length ?? 0)
  if (broken) { tone = worse(tone, 'warn'); words.push(`${counted(broken, 'channel')} stuck or saturated.`) }
  if (!words.length) {
    const last = lastTrial(run, seen.trial, suspenders)
    tone = last.tone
    words.push(last.words)
  }
  // Without a fresh frame nothing says that the data are good now.
  return { tone: tone === '' || tone === 'good' ? seen.stuck ? 'good' : '' : tone, words: words.join(' ') }
}

/** Backlog of the twins, as text. */
export function backlog(twins, run) {
  if (!twins) return null
  const of = twins.runs.find(r => r.run === run) ?? null
  if (!of) return null
  const rate = of.pending > 20 && twins.pool.per_s ? ` at ${fixed(twins.pool.per_s, 0)} per s` : ''
  return `${count(of.pending)} to do${rate}${of.failures ? `, ${count(of.failures)} failed` : ''}`
}
