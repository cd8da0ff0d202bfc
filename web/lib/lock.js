// The operator lock: why it keeps this caller from acting, and controls that state it instead of acting.

import { live } from './live.js'

const holds = lock => live.caller?.name != null && live.caller.name === lock.holder

/** Why the lock refuses what the caller wants to start, edit or move, as text; '' if it does not. */
export function lockWords() {
  const lock = live.status?.lock
  if (!lock || holds(lock)) return ''
  const all = lock.keyless ? ' It holds for every caller.' : '' // Without a key none can prove to be the holder.
  return `${lock.holder} has the operator lock: ${lock.note.replace(/[.\s]+$/, '')}.${all}`
}

/** Whether the caller may release the lock: its holder, an admin, and without a key one that was taken without a key. */
export const mayRelease = lock => holds(lock) || live.may('admin') || lock.keyless && live.caller != null && live.caller.name == null

const mark = (node, why) => {
  node.ariaDisabled = why ? 'true' : null
  node.title = why || node.dataset.title
}

/** Makes of a button one that the lock refuses: a press states why (`tell`), and does nothing else. */
export function locked(node, tell = () => {}) {
  node.dataset.lock = 'yes'
  node.dataset.title = node.title
  node.addEventListener('click', event => {
    const why = lockWords()
    if (!why) return
    event.stopImmediatePropagation()
    tell(why, 'warn')
  }, { capture: true })
  mark(node, lockWords())
  return node
}

let shown = ''
const follow = () => {
  const why = lockWords()
  if (why !== shown) document.querySelectorAll('[data-lock]').forEach(node => mark(node, why))
  shown = why
}
for (const kind of ['status', 'caller']) live.addEventListener(kind, follow)
