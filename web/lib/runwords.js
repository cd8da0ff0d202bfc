// What runs are called in lists and reports: state, end, kind; and what is computed from their summaries. No DOM.

import { capital, count, fixed, listed, moment, plain, span } from './format.js'
import { meaning } from './vocabulary.js'

const ENDS = { success: 'finished', stopped: 'stopped', abort: 'aborted', fail: 'failed' }
const ACTIVE = 'idle,running,pausing,paused,stopping,aborting,suspending,panicked'

/** Condition on runs that began: what is listed if the address has none on their state. */
export const BEGUN = { state__in: `${ACTIVE},interrupted,ended` }

/** Choices of the filter by state: condition and words. */
export const STATES = [
  ['', 'that began'],
  [`state__in=${ACTIVE}`, 'active'],
  ['state=interrupted', 'interrupted'],
  ['exit_status=success', 'finished'],
  ['exit_status=stopped', 'stopped'],
  ['exit_status=abort', 'aborted'],
  ['exit_status=fail', 'failed'],
  ['state=queued', 'queued'],
  ['state=removed', 'removed from the queue'],
  ['scan_id__gte=1', 'all'],
]

/** Whether a run holds the rig. */
export const isActive = run => !['queued', 'removed', 'ended', 'interrupted'].includes(run.state)

/** The state of the active run, with the one that was requested. */
export const stateWords = run => `${plain(run.state)}${{ paused: ', pause requested', idle: ', end requested' }[run.requested_state] ?? ''}`

/** A state of the rig or of a run, with the homing or jog in progress, as `live` has it. */
export const withMotion = (words, motion) => listed([words, motion && plain(motion)])

/** The homing or jog in progress as a sentence; '' if there is none. */
export const motionWords = motion => motion ? `${capital(plain(motion))} in progress: the axes move.` : ''

/** State or end in one word. */
export const endWord = run => (run.state === 'ended' ? (ENDS[run.exit_status] ?? plain(run.exit_status ?? 'ended')) : plain(run.state))

/** Tone of a run: success is quiet. */
export const runTone = run =>
  run.exit_status === 'fail' ? 'bad' : ['abort', 'stopped'].includes(run.exit_status) || run.state === 'interrupted' ? 'warn' : isActive(run) ? 'good' : ''

/** One sentence: what state a run is in, why, and what follows. */
export function runSentence(run) {
  if (run.state === 'ended')
    return `It ${ENDS[run.exit_status] ?? 'ended'}${run.ended_at ? ` ${moment(run.ended_at)}` : ''}${run.reason ? `: ${run.reason}` : ''}.${
      run.is_resumable ? ' Its trials are stored, and it can be resumed.' : ''}`
  if (run.state === 'interrupted') return 'It was interrupted: its trials are stored. Resume it to take those that are missing, or abort it.'
  if (run.state === 'queued') return run.waiting_since ? 'It is started and waits for its turn.' : 'It is queued: it begins when a person arms and starts it.'
  if (run.state === 'removed') return 'It was removed from the queue before it began.'
  return `It is ${plain(run.state)}${run.paused_why ? `: ${meaning('pauses', run.paused_why)}` : ''}.`
}

/** Trials stored in an hour, from start to end, with all waits; null before the end. */
export const perHour = summary => (summary.duration_s > 0 ? (summary.trials_stored / summary.duration_s) * 3600 : null)

/** Median of the values that are known, or null. */
export function median(values) {
  const known = (values ?? []).filter(v => v != null).sort((a, b) => a - b)
  const half = known.length >> 1
  return !known.length ? null : known.length % 2 ? known[half] : (known[half - 1] + known[half]) / 2
}

/** Largest of the values that are known, or null. */
export const largest = values => (values ?? []).reduce((most, v) => (v == null || most > v ? most : v), null)

/** What two runs are compared by: [name, text] rows of one of them. */
export function runRows({ run, summary, progress, fit }) {
  const rate = perHour(summary)
  return [
    ['Experiment', run.experiment],
    ['Kind', run.kind],
    ['Label', run.label],
    ['Seed', run.seed == null ? 'none' : String(run.seed)],
    ['End', endWord(run)],
    ['Planned', count(run.trials_planned)],
    ['Stored', count(summary.trials_stored)],
    ['Trials of skipped configurations', count(summary.trials_skipped)],
    ['Failed attempts', count(summary.retries)],
    ['Duration', span(summary.duration_s)],
    ['Trials per hour', count(rate && Math.round(rate))],
    ['Largest force', fixed(largest(progress?.largest_force_n), 1, 'N')],
    ['Median FVU', fixed(fit?.median_fvu, 3)],
    ['Median RMSE', fixed(fit?.median_rmse_v && fit.median_rmse_v * 1e3, 2, 'mV')],
    ['Deadband', fixed(run.deadband_n, 1, 'N')],
    ['Calibration', run.calibration_id ?? 'that of the sensor file'],
    ['Rig file', run.rig_sha256?.slice(0, 8) ?? 'none'],
    ['Sensor file', run.sensor_sha256.slice(0, 8)],
    ['Version', run.version],
    ['Commit', run.git_commit?.slice(0, 8) ?? 'unknown'],
  ]
}
