// Tones of states and events. No DOM.

/** Tone of a state: the class that colours it. */
export const TONE = { running: 'good', armed: 'good', homed: 'good', completed: 'good', success: 'good', serving: 'good', done: 'good',
  pausing: 'warn', paused: 'warn', stopping: 'warn', suspending: 'warn', interrupted: 'warn', waiting: 'warn', stopped: 'warn',
  aborting: 'bad', panicked: 'bad', tripped: 'bad', failed: 'bad', fail: 'bad', abort: 'bad' }

/** Whether work of the service, as a job or an export, has not ended. */
export const isUnderWay = job => ['waiting', 'running'].includes(job.state)

/** Class that colours an event, by its importance. */
export const LOUD = { act: 'bad', look: 'warn' }
