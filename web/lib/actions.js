// Actions: who does them, what was refused. Every button of every page acts through here.

import { Refused, Unanswered, person, send } from './api.js'
import { button, el, fill, note, say } from './dom.js'
import { live, who } from './live.js'
import { lockWords, locked } from './lock.js'

/**
 * Opens a dialog over the page. The page behind it takes no click and no key: the dialog has a stop as well, in view however
 * far a long dialog is scrolled, and a press where the page's stop is still presses it. A stop closes the dialog, unconfirmed.
 */
export function modal(box) {
  const stop = document.getElementById('stop'), press = () => { box.close(); stop.click() }
  box.addEventListener('click', ({ target, clientX, clientY }) => {
    const { left, right, top, bottom } = stop.getBoundingClientRect()
    if (target === box && clientX >= left && clientX <= right && clientY >= top && clientY <= bottom) press()
  })
  // The key that opened the dialog may be held still: its repetitions must not press the button that has the focus.
  box.addEventListener('keydown', event => { if (event.repeat && event.key === 'Enter') event.preventDefault() })
  box.append(el('div', { className: 'row over' }, button('Stop the rig', press, { className: 'stop' })))
  document.body.append(box)
  box.showModal()
}

/** Asks for the name that actions are logged with, once per browser; resolves to false if it is refused. */
export function named() {
  if (who()) return Promise.resolve(true)
  return new Promise(resolve => {
    const input = el('input', { autocomplete: 'name', maxLength: 80, required: true, id: 'who-input' })
    const box = el('dialog', { 'aria-labelledby': 'who-title', onclose: () => { box.remove(); resolve(Boolean(who())) } },
      el('form', { method: 'dialog', onsubmit: () => { person.name = input.value } },
        el('h2', { id: 'who-title' }, 'Your name'), el('p', { className: 'soft' }, 'It is logged with every action. This browser keeps it.'),
        el('label', { htmlFor: 'who-input' }, 'Name'), input,
        el('div', { className: 'row' }, el('button', { className: 'main' }, 'Continue'), button('Cancel', () => box.close(), { className: 'plain' }))))
    modal(box)
  })
}

/**
 * Asks before something that cannot be undone; resolves to whether it was confirmed. Never for a stop.
 * It closes, unconfirmed, as soon as `holds(status)` is false: it is asked with each status, and when the connection is lost.
 */
export function confirm(title, words, verb = 'Continue', holds = () => true) {
  return new Promise(resolve => {
    const over = new AbortController()
    let sure = false
    const agree = ({ detail }) => {
      if (detail > 1) return // The second click of a double click, whose first one opened the dialog.
      sure = true
      box.close()
    }
    const box = el('dialog', { 'aria-label': title, onclose: () => { over.abort(); box.remove(); resolve(sure) } }, el('h2', {}, title),
      [words].flat().map(text => typeof text === 'string' ? el('p', {}, text) : text),
      el('div', { className: 'row' }, button(verb, agree, { className: 'main' }), button('Cancel', () => box.close(), { className: 'plain' })))
    modal(box)
    for (const kind of ['status', 'fresh']) live.on(kind, ({ status }) => status && !holds(status) && box.close(), over.signal)
  })
}

/** A line that says what became of the last action: `outcome()` returns { node, tell, run }. What became of one is brought into view. */
export function outcome() {
  const node = el('p', { className: 'said', role: 'status', hidden: true })
  const tell = (words, tone = 'soft') => { note(node, words); node.className = `said ${tone}` }
  /** Runs an action; a refusal becomes words. Resolves to its result, or undefined. `done` says what its answer means. */
  const run = async (words, work, done = 'done') => {
    tell(`${words} …`)
    try {
      const result = await work()
      tell(`${words}: ${done}.`)
      return result
    } catch (error) {
      if (error.name === 'AbortError') return undefined
      const late = error instanceof Unanswered ? ' It may be carried out late.' : ''
      tell(error instanceof Refused ? `${words}: refused. ${error.message}` : `${words}: no answer (${error.message}).${late}`, 'bad')
      return undefined
    } finally {
      // The line may be far from the button, which would seem to do nothing.
      node.scrollIntoView({ block: 'nearest' })
    }
  }
  return { node, tell, run }
}

/**
 * Makes a button that asks for the name, acts, shows the outcome, and is hidden from those who may not. While another
 * person's operator lock refuses it (`locks`), a press states this alone.
 * `work` gets what `seen()` returned at the press: what the person saw, whatever came meanwhile. `done`: see `outcome`.
 */
export function actor(words, said, work, { role = 'operator', locks = role === 'operator', seen = () => undefined, sure = () => true, done, ...props } = {}) {
  const node = button(words, async () => {
    if (node.dataset.busy) return // Who enables it again meanwhile would allow a second request.
    const what = seen()
    if (!await sure() || !await named()) return
    node.disabled = true
    node.dataset.busy = 'yes'
    try { await said.run(props.what ?? words, () => work(what), done) } finally { delete node.dataset.busy; node.disabled = false }
  }, props)
  return only(role, locks ? locked(node, said.tell) : node)
}

/** Hides a control, or a whole form, from callers who may not use it. The rule of app.css follows `data-caller` of the document. */
export function only(role, node) {
  node.dataset.role = role
  return node
}
live.addEventListener('caller', () => { document.documentElement.dataset.caller = live.caller?.role ?? 'viewer' })

/** Sends what may move the rig, with the time of the newest status: the service refuses it long after, unless it stops a run. */
export const sendNow = (path, body, options) => send(path, body, { ...options, headers: live.status ? { 'status-at': live.status.at } : {} })

/** An action on a run. */
export const actOnRun = (run, action, more = {}) => sendNow(`/runs/${run}/actions`, { action, who: who(), ...more }, { wait: 15_000 })
/**
 * An action on the rig, sent once: long after the press, no axis must move, nothing must be tared, and no stop that another
 * person pressed since must be reset.
 */
export const actOnRig = (action, more = {}) => sendNow('/rig/actions', { action, who: who(), ...more }, { wait: action === 'home' ? 4000 : 15_000 })

/** Ends a homing or a jog, however late it comes: the axes stop, then the tips rise. */
export const endMotion = () => send('/rig/abort', { who: who() }, { wait: 15_000 })

/** Why the rig or its run would refuse an action on the rig now, in the service's words; '' if they would not. */
export const refusal = ({ rig_actions }, action) => {
  const found = rig_actions.find(one => one.action === action)
  return found ? found.refused ?? '' : 'this rig has no such action'
}

/** The same for an action on the active run; `start` is of a run that waits. */
export const runRefusal = ({ run_actions }, action) => run_actions.find(one => one.action === action)?.refused ?? ''

/** Asks before a real rig moves; closes if the service would now refuse it (`refused`), or if the connection is lost. */
const sureMotion = (title, words, verb, refused) => live.status?.rig.label === 'virtual' ||
  confirm(title, `${words} Keep hands and tools away from the rig.`, verb, status => live.fresh && !refused(status))

/** Asks before the axes of a real rig are homed. */
export const sureHome = () => sureMotion('Home the axes?', 'They move.', 'Home', status => refusal(status, 'home'))

/** Asks before a paused run moves a real rig: a person may have come to it since. A skin alone does not move. */
const sureResume = () => live.status?.rig.has_stage === false ||
  sureMotion('Resume the run?', 'The axes move.', 'Resume', status => runRefusal(status, 'resume'))

/**
 * The buttons of the active run: what the service would not refuse now, except for those of `without`. A repetition is
 * of one placement: its page has it. While the run is paused and would not continue, the reason is next to them.
 */
export function runButtons(said, { without = [] } = {}) {
  const node = el('div', { className: 'row' }), why = el('span', { className: 'soft small' })
  let shown = ''
  const act = (words, action, more, props) => actor(words, said, run => actOnRun(run.uid, action, more?.(run)), { seen: () => live.status.run, ...props })
  const SETS = {
    pause: () => act('Pause', 'pause', () => ({ when: 'checkpoint' }), { role: 'viewer', title: 'Finish the trial, raise the tips, wait; after a trip: do not resume automatically' }),
    resume: () => act('Resume', 'resume', null, { className: 'main', sure: sureResume }),
    confirm: () => act('Done, continue', 'confirm', ({ wanted }) => ({ trial: wanted?.trial, tips: wanted?.tips }), { className: 'main' }),
    stop: () => act('End run', 'stop', null, { role: 'viewer', title: 'Finish the trial, raise the tips, end the run' }),
    abort: () => button('Abort', async () => {
      const { uid, scan_id } = live.status.run, holds = ({ run }) => run?.uid === uid
      const sure = await confirm(`Abort run ${scan_id}?`, 'The tips are raised now and the run ends. The present trial is not stored; stored trials stay.', 'Abort the run', holds)
      if (!holds(live.status)) said.tell(`Run ${scan_id} has ended meanwhile: nothing was aborted.`)
      else if (sure && await named()) said.run('Abort', () => actOnRun(uid, 'abort'))
    }, { title: 'Raise the tips now, end the run' }),
  }
  const show = ({ status, fresh }) => {
    const run = status?.run, offered = name => !without.includes(name) && !runRefusal(status, name)
    const wanted = run ? Object.keys(SETS).filter(offered) : [], names = wanted.join()
    if (shown !== names) { shown = names; fill(node, wanted.map(name => SETS[name]())) }
    const held = live.may('operator') && ['resume', 'confirm'].some(name => wanted.includes(name)) ? lockWords() : ''
    // What a tip change asked for stays in the status while a trip halts the run: the reason of the pause counts.
    const next = ['tip_change', 'manual_trial'].includes(run?.paused_why) ? 'confirm' : 'resume'
    const halted = run?.state === 'paused' ? runRefusal(status, next) : '', words = held || halted
    say(why, words)
    if (node.contains(why) !== Boolean(words)) words ? node.append(why) : why.remove()
    for (const one of node.children) one.inert = !fresh
  }
  return { node, show }
}
