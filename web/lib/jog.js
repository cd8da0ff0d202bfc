// Jog: small moves while a button or a key is held, one after the other. Releasing sends no further one, so
// that at most one small move is still carried out.

import { named, sendNow } from './actions.js'
import { button, el, say, select, sleep } from './dom.js'
import { fixed } from './format.js'
import { live, who } from './live.js'

// At least REST_MS between two moves: at most 20 mm/s, and 4 mm/s for z.
const WAIT_MS = 10_000, FRESH_MS = 1200, REST_MS = 50
const STEPS = { flat: [0.1, 0.5, 1], down: [0.05, 0.1, 0.2] }
const among = (sizes, wanted, usual) => (sizes.some(mm => String(mm) === wanted) ? wanted : usual)

/** Sizes of a move, mm, as the address has them; what no choice offers is the usual one. */
export const stepsOf = ({ step, stepz }) => ({ xy: among(STEPS.flat, step, '0.5'), z: among(STEPS.down, stepz, '0.1') })

const HOLD = 'Hold a button: small moves follow one another until you let go. '
  + 'z is lowered to the safe height at most; the touch-off alone moves into the skin.'
// Words, key, axis, direction. z counts downwards from the raised position.
const MOVES = [['y +', 'ArrowUp', 'y', 1], ['x \u2212', 'ArrowLeft', 'x', -1], ['x +', 'ArrowRight', 'x', 1], ['y \u2212', 'ArrowDown', 'y', -1],
  ['Raise', 'PageUp', 'z', -1], ['Lower', 'PageDown', 'z', 1], ['Arms in', '[', 'radius', -1], ['Arms out', ']', 'radius', 1]]

/** Makes the pad. `allowed()` returns why it must not move, or ''. `gate()` shows it. Ends with `signal`. */
export function jog({ allowed, steps, choose, signal }) {
  const told = el('p', { className: 'said', role: 'status' }), why = el('p', { className: 'soft' })
  // The shown pose is up to half a second old: a second press soon after continues from where the first one ended.
  let held = null, last = { axis: '', to: 0, at: 0 }
  const size = axis => axis === 'z' ? Number(steps().z) : Number(steps().xy)

  /** Sends moves until released: the next one only after the previous one is accepted. */
  async function hold(move) {
    const [words, , axis, direction] = move
    release()
    const reason = allowed() || (live.status?.rig.pose ? '' : 'The pose is not known.')
    if (reason) return void say(told, reason)
    if (!who()) return void named() // Asked before a motion, not during one.
    const mine = held = {}
    // Whatever this computer's clock was set to since, `last` is of this moment only.
    let to = last.axis === axis && Math.abs(Date.now() - last.at) < FRESH_MS ? last.to : live.status.rig.pose[`${axis}_mm`]
    while (held === mine && !signal.aborted) {
      if (allowed() || document.hidden) break
      const begun = Date.now()
      to = Number((to + direction * size(axis)).toFixed(3))
      say(told, `${words}: ${axis} to ${fixed(to, 2, 'mm')}`)
      try {
        await sendNow('/rig/actions', { action: 'jog', axis, to_mm: to, who: who() }, { wait: WAIT_MS, signal })
        last = { axis, to, at: Date.now() }
        await sleep(begun + REST_MS - Date.now(), signal)
      } catch (error) {
        if (!signal.aborted) say(told, `${words}: ${error.status ? `refused. ${error.message}` : `no answer (${error.message})`}.`)
        break
      }
    }
    if (held === mine) held = null
    return undefined
  }
  function release() { held = null }

  const buttons = MOVES.map(move => {
    const [words, key, axis, direction] = move
    const one = button(words, () => {}, { className: `jog jog-${axis}${direction > 0 ? '-more' : '-less'}`,
      title: `Hold: ${axis} ${direction > 0 ? 'increases' : 'decreases'}. Key: ${key}` })
    one.addEventListener('pointerdown', event => { if (event.button) return; one.setPointerCapture(event.pointerId); hold(move) })
    for (const kind of ['pointerup', 'pointercancel', 'lostpointercapture']) one.addEventListener(kind, release)
    one.addEventListener('contextmenu', event => event.preventDefault())
    one.addEventListener('keydown', event => { if ([' ', 'Enter'].includes(event.key) && !event.repeat) { event.preventDefault(); hold(move) } })
    return one
  })
  const pad = axes => el('div', { className: `pad pad-${axes[0]}` }, buttons.filter((_, i) => axes.includes(MOVES[i][2])))
  const sizes = Object.fromEntries([['xy', STEPS.flat], ['z', STEPS.down]].map(([key, choices]) => [key,
    select(choices.map(mm => [mm, `${mm} mm`]), steps()[key], mm => choose({ [key]: mm }))]))
  const step = key => el('label', { className: 'inline' }, key === 'xy' ? 'Step of x, y and arms' : 'Step of z', sizes[key])
  const node = el('div', { tabIndex: 0, role: 'group', 'aria-label': 'Jog: hold a button, or an arrow key while this group has the focus' },
    why, el('div', { className: 'row' }, pad(['x', 'y']), pad(['z']), pad(['radius'])),
      el('div', { className: 'row' }, step('xy'), step('z')), told)
  // Keys move only while the group has the focus, and only while they are down.
  node.addEventListener('keydown', event => {
    const move = MOVES.find(([, key]) => key === event.key)
    if (!move || event.target.matches('select') || event.ctrlKey || event.metaKey || event.altKey) return
    event.preventDefault()
    if (!event.repeat) hold(move)
  })
  node.addEventListener('keyup', release)
  node.addEventListener('focusout', event => { if (!node.contains(event.relatedTarget)) release() })
  for (const kind of ['blur', 'pagehide']) addEventListener(kind, release, { signal })
  document.addEventListener('visibilitychange', release, { signal })
  signal.addEventListener('abort', release)
  live.on('fresh', ({ fresh }) => { if (!fresh) release() }, signal)

  /** Shows whether it may move, and why not. */
  function gate() {
    const reason = allowed()
    if (reason) release()
    say(why, reason || HOLD)
    for (const one of buttons) one.disabled = Boolean(reason)
  }
  /** Shows the sizes of the address. */
  function follow() {
    for (const [key, one] of Object.entries(sizes)) one.value = steps()[key]
  }
  return { node, gate, follow }
}
