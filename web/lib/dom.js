// Elements: how all modules make and change them. Uses the DOM alone.

/** Whether the page is dark. */
export const dark = matchMedia('(prefers-color-scheme: dark)')

/** Makes an element: properties that exist are set, functions named on… listen, others are attributes. */
export function el(tag, props = {}, ...inside) {
  const node = document.createElement(tag)
  set(node, props)
  node.append(...inside.flat(3).filter(child => child != null && child !== false))
  return node
}

/** Sets properties of an element; see `el`. */
export function set(node, props) {
  for (const [key, value] of Object.entries(props)) {
    if (value == null) continue
    if (key.startsWith('on') && typeof value === 'function') node.addEventListener(key.slice(2), value)
    else if (key === 'style') Object.assign(node.style, value)
    else if (key === 'data') Object.assign(node.dataset, value)
    else if (key in node && !key.startsWith('aria')) node[key] = value
    else if (value === false && !key.startsWith('aria')) node.removeAttribute(key)
    else node.setAttribute(key, value)
  }
  return node
}

/** Replaces what is in an element. */
export function fill(node, ...inside) {
  node.replaceChildren(...inside.flat(3).filter(child => child != null && child !== false))
  return node
}

const drawn = new WeakMap()
/** Replaces what is in an element by what `draw()` makes, only if `of` differs from that of the last time: a focus in it stays. */
export function renew(node, of, draw) {
  const text = JSON.stringify([of])
  if (drawn.get(node) !== text) fill(node, draw())
  drawn.set(node, text)
}

/** Sets a text only if it differs, so that a screen reader is not told again. */
export function say(node, text) {
  const words = text == null ? '' : String(text)
  if (node.textContent !== words) node.textContent = words
  return node
}

/** Shows a text, or hides the element if there is none. */
export function note(node, text) {
  say(node, text)
  if (node.hidden === Boolean(text)) node.hidden = !text // Setting the same again would compute styles again.
}

/** Makes a section with a heading: `panel('Forces', {}, …)`. `props.aside` is next to the heading. */
export function panel(title, { aside, ...props } = {}, ...inside) {
  const heading = el('h2', {}, el('span', {}, title), aside ?? '')
  return el('section', { 'aria-label': title, ...props }, heading, ...inside)
}

/** Makes a section without a heading, for pictures that have their own. */
export const pane = (...inside) => el('section', {}, inside)

/** Makes a list of facts: `facts([['Age', node or text], …])`. */
export function facts(rows, props = {}) {
  const row = ([name, value]) => el('div', {}, el('dt', {}, name), el('dd', {}, value))
  return el('dl', { className: 'facts', ...props }, rows.filter(Boolean).map(row))
}

/** Makes a control with its label; `id` is that of the control. */
export function field(words, control, id = control.id) {
  control.id = id
  return el('div', {}, el('label', { htmlFor: id }, words), control)
}

/** Makes a form; `submit()` is called instead of sending it. */
export const form = (submit, props, ...inside) =>
  el('form', { ...props, onsubmit: event => { event.preventDefault(); submit() } }, ...inside)

/** Makes a button. `props.title` says what it does where its word alone does not. */
export function button(words, onclick, props = {}) {
  return el('button', { type: 'button', onclick, ...props }, words)
}

/** Makes a link to a page of the dashboard. */
export const link = (href, ...inside) => el('a', { href }, ...inside)

/** Makes a select: `choices` are texts or [value, words]. */
export function select(choices, value, onchange, props = {}) {
  const option = choice => {
    const [of, words] = Array.isArray(choice) ? choice : [choice, choice]
    return el('option', { value: of, selected: String(of) === String(value) }, words)
  }
  return el('select', { onchange: event => onchange(event.target.value), ...props }, choices.map(option))
}

/** Gives a select a value; one that is no choice of it becomes one. */
export function choose(node, value) {
  if (![...node.options].some(option => option.value === value)) node.append(el('option', { value }, value))
  node.value = value
}

/** Calls `draw` once before the next picture, however often it is asked for. */
export function soon(draw) {
  let asked = 0
  return () => { asked ||= requestAnimationFrame(() => { asked = 0; draw() }) }
}

const BEAT_MS = 100
let beat = null, beaten = 0

/**
 * Like `soon`, for what follows live values: all such drawings share one picture, at most ten times per
 * second. A separate picture for each would cost a layout and a painting of the page.
 */
export function onBeat(draw) {
  const run = () => {
    const drawings = beat
    beat = null
    beaten = performance.now()
    for (const one of drawings) one()
  }
  return () => {
    if (!beat) {
      beat = new Set()
      setTimeout(run, Math.max(0, beaten + BEAT_MS - performance.now()))
    }
    beat.add(draw)
  }
}

/** Calls `then` whenever light changes to dark, or the size of `node`; ends with `signal`. */
export function onLook(node, then, signal) {
  const sizes = new ResizeObserver(then)
  sizes.observe(node)
  dark.addEventListener('change', then, { signal })
  signal?.addEventListener('abort', () => sizes.disconnect())
}

const colours = new Map()
let coloursOf = null

/** Value of a colour of app.css: `colour('--live')`. Kept, because asking makes the browser compute all styles. */
export function colour(name) {
  if (coloursOf !== dark.matches) { // The light changes before its event comes.
    colours.clear()
    coloursOf = dark.matches
  }
  if (!colours.has(name)) {
    const value = getComputedStyle(document.documentElement).getPropertyValue(name).trim()
    if (!value) return value // The styles have not come yet.
    colours.set(name, value)
  }
  return colours.get(name)
}

/** Waits. */
export const sleep = (ms, signal) => new Promise(resolve => {
  const end = () => { clearTimeout(timer); signal?.removeEventListener('abort', end); resolve() }
  const timer = setTimeout(end, ms)
  signal?.addEventListener('abort', end, { once: true })
})

/** Makes a function for work of which only the newest counts: it returns a signal that aborts at its next call, or with `signal`. */
export function replacing(signal) {
  let ending = new AbortController()
  return () => {
    ending.abort()
    ending = new AbortController()
    return AbortSignal.any([signal, ending.signal])
  }
}

/** Resolves once the page is seen, or `signal` aborts. */
export const seen = signal => new Promise(resolve => {
  const over = new AbortController()
  const look = () => {
    if (document.hidden && !signal.aborted) return
    over.abort()
    resolve()
  }
  document.addEventListener('visibilitychange', look, { signal: over.signal })
  signal.addEventListener('abort', look, { signal: over.signal })
  look()
})

/**
 * Calls `work` now and again `ms` after its end, until `signal` aborts; `ms` may be a function. While the page is hidden
 * it rests; once it is seen again, what is old is read at once.
 */
export async function every(ms, work, signal) {
  for (; !signal.aborted; await sleep(typeof ms === 'function' ? ms() : ms, signal)) {
    await seen(signal)
    if (!signal.aborted) await work()
  }
}

/** Gives a file to the browser. */
export function download(name, content, type) {
  const url = URL.createObjectURL(content instanceof Blob ? content : new Blob([content], { type }))
  el('a', { href: url, download: name }).click()
  setTimeout(() => URL.revokeObjectURL(url), 10_000)
}
