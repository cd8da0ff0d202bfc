// The shell: top bar with the stop, links, the key, and the page of the address. Knows no data.

import { address, go, params, set, shown } from './lib/address.js'
import { Stopped, door, estop, giveKey, hasKey } from './lib/api.js'
import { actOnRig, actor, modal, outcome, sureHome } from './lib/actions.js'
import { button, el, fill, link, note, say } from './lib/dom.js'
import { clock, listed, moment, momentBand, percent, plain, span, steadyCountOf } from './lib/format.js'
import { steadyEnds } from './lib/eta.js'
import { live, start } from './lib/live.js'
import { READ_KEYS } from './lib/readkeys.js'
import { stateWords, withMotion } from './lib/runwords.js'
import { readVocabulary } from './lib/vocabulary.js'
import { TONE } from './lib/words.js'
import { FIRST, PAGES } from './pages.js'

const $ = id => document.getElementById(id)

// Pages: the address is the whole state. A page is a module with `show(root, context)`, called
// again with new parameters only if it returns no `update`; `signal` aborts when it is left.
let leaving = new AbortController(), present = null

async function open() {
  const name = shown().pathname.slice(1) || FIRST, page = PAGES.find(page => page.name === name)
  const query = params()
  for (const one of document.querySelectorAll('#links a')) {
    if (one.dataset.page === name) {
      one.ariaCurrent = 'page'
      const { parentNode: row } = one
      row.scrollLeft = one.offsetLeft - (row.clientWidth - one.offsetWidth) / 2 // On a phone the links are wider than the screen.
    }
    else one.removeAttribute('aria-current')
  }
  if (present?.name === name && present.isLoading) return undefined // It follows the address once it is there.
  if (present?.name === name && present.update) {
    const updated = present.update(query)
    reach()
    return updated
  }
  leaving.abort()
  leaving = new AbortController()
  present = { name, isLoading: Boolean(page) }
  const { signal } = leaving, root = $('main')
  document.body.dataset.page = name
  entitle()
  if (!page) return fill(root, el('section', {}, el('h1', {}, 'No such page'), el('p', {}, link('/', 'The night'), ' is where to begin.')))
  try {
    const [module] = await Promise.all([import(`./pages/${name}.js`), readVocabulary()])
    if (signal.aborted) return undefined
    const head = el('div', { className: 'page-head' }, el('h1', {}, page.title), el('p', { className: 'soft' }, page.about))
    const body = el('div', { className: `page page-${name}` })
    fill(root, head, body)
    scrollTo(0, 0)
    const { update } = await module.show(body, { query, signal, go, set }) ?? {}
    if (signal.aborted) return undefined
    present = { name, update }
    if (!isSame(query, params())) return open()
    reach()
  } catch (error) {
    if (signal.aborted) return undefined
    present = { name }
    if (error instanceof Stopped) return open()
    fill(root, el('section', {}, el('h1', {}, page.title), el('p', { className: 'bad' }, `This page could not be shown: ${error.message}`), button('Try again', () => { present = null; open() })))
  }
  return undefined
}

const isSame = (a, b) => Object.keys({ ...a, ...b }).every(key => a[key] === b[key])

/** Scrolls to the part that the address names, as in /data#exports. */
function reach() {
  const { hash } = shown()
  if (hash) document.getElementById(hash.slice(1))?.scrollIntoView({ block: 'start' })
}

document.addEventListener('click', event => {
  const a = event.target.closest?.('a[href^="/"]')
  if (!a || a.target || a.download || event.metaKey || event.ctrlKey || event.shiftKey || event.button) return
  const name = new URL(a.href).pathname.slice(1) || FIRST
  if (!PAGES.some(page => page.name === name)) return
  event.preventDefault()
  go(a.getAttribute('href'))
})
address.addEventListener('open', open)

// Links and keys: g then a letter opens a page, ? lists them. No key stops or starts anything.
let group = ''
fill($('links'), PAGES.map(page => {
  const begins = page.group !== group
  group = page.group
  return el('a', { href: page.name === FIRST ? '/' : `/${page.name}`, title: page.about, data: { page: page.name, begins: begins ? 'yes' : 'no' } }, page.title)
}))
// The module of a page is read when a pointer or the focus reaches its link: the click finds it.
for (const kind of ['pointerover', 'focusin', 'touchstart']) {
  $('links').addEventListener(kind, ({ target }) => target.dataset.page && import(`./pages/${target.dataset.page}.js`).catch(() => {}), { passive: true })
}
let chord = 0
document.addEventListener('keydown', event => {
  if (event.target.closest?.('input, select, textarea, dialog') || event.metaKey || event.ctrlKey || event.altKey) return
  const page = Date.now() - chord < 1500 && PAGES.find(page => page.key === event.key)
  chord = event.key === 'g' ? Date.now() : 0
  if (page) go(page.name === FIRST ? '/' : `/${page.name}`)
  if (event.key === '?') help()
})
function help() {
  const list = rows => el('dl', { className: 'keys' }, rows.map(([keys, words]) => el('div', {}, el('dt', {}, keys), el('dd', {}, words))))
  const pages = PAGES.map(page => [[el('kbd', {}, 'g'), ' ', el('kbd', {}, page.key)], page.title])
  const box = el('dialog', { className: 'help', 'aria-label': 'Keys', onclose: () => box.remove() }, el('h2', {}, 'Keys'),
    el('div', { className: 'help-columns' }, list([...pages, [el('kbd', {}, '?'), 'this list']]),
      el('div', {}, READ_KEYS.map(([title, rows]) => [el('h3', {}, title), list(rows)]))),
    el('p', { className: 'soft' }, 'No key stops the rig: use the stop button, or the one on the rig.'), button('Close', () => box.close()))
  modal(box)
}

// The stop: sends without a question and shows the outcome until that is over, and what state was reached.
let press = null, presses = 0
function stopSaid(words, ...more) {
  fill($('stop-said'), words, more)
  $('stop-said').hidden = !words
}
$('stop').onclick = async () => {
  const mine = presses += 1
  press = null
  stopSaid('Stopping …')
  const { latched, words } = await estop()
  if (mine !== presses) return // What came of the newest press is told.
  const closed = live.fresh && live.status.rig.state === 'disconnected' ? ' The wires are closed: nothing moves, and the stop holds when they are opened.' : ''
  press = { latched, words, tripped: false, of: live.status?.service.started_at }
  stopSaid(words + (latched ? closed : ''), !latched && button('Close', () => stopSaid(''), { className: 'plain' }))
}

/** Clears what is said of a press: that it is latched, once it was reset; that it is not confirmed, once a stop is latched. */
function stopState({ rig, service }) {
  if (!press) return
  const tripped = rig.state === 'tripped'
  const over = press.latched ? press.tripped && !tripped || Boolean(press.of) && service.started_at !== press.of : rig.trip?.kind === 'estop'
  if (over) { press = null; return stopSaid('') }
  if (press.latched && tripped && !press.tripped) { press.tripped = true; stopSaid(press.words) }
}

// The key: a form in place of the page, until one is given.
door.addEventListener('locked', ({ detail }) => {
  if ($('key-form')) return
  const input = el('input', { id: 'key', type: 'password', autocomplete: 'off', required: true }), wrong = el('p', { role: 'alert', hidden: true })
  const give = text => {
    note(wrong, giveKey(text))
    if (wrong.hidden) reopen(form)
  }
  const form = el('form', { id: 'key-form', className: 'notice', onsubmit: event => { event.preventDefault(); give(input.value) } },
    el('label', { htmlFor: 'key' }, `${detail} Key of this service:`),
    el('div', { className: 'row' }, input, el('button', { className: 'main' }, 'Continue'), hasKey() && button('Continue without a key', () => give(''), { className: 'plain' })), wrong)
  document.querySelector('header').append(form)
})
door.addEventListener('opened', () => { if ($('key-form')) reopen($('key-form')) })
function reopen(form) {
  form.remove()
  present = null
  open()
}

// The top bar: the state on every page.
const said = outcome()
const needed = el('p'), repair = el('div', { className: 'row' })
fill($('needs'), needed, repair, said.node)
let repairs = false // A button of it acts: the focus, which was on that button, stays here when another replaces it.
/** Does what the button of a need is for. */
async function mend(action) {
  repairs = true
  try { return await actOnRig(action) } catch (error) { repairs = false; throw error }
}
function etaWords(run, at) {
  if (!run?.eta || run.trials_stored + run.trials_skipped >= run.trials_planned) return ''
  if (!['running', 'pausing'].includes(run.state)) return `about ${span(run.eta.remaining_s)} to go`
  return `done about ${momentBand(...steadyEnds(run, at), run.eta.high_s < 900)}`
}
live.on('status', ({ status, at, motion }) => {
  const { rig, run } = status
  stopState(status)
  $('virtual').hidden = rig.label !== 'virtual'
  say($('rig-name'), rig.name)
  say($('bar-state'), run ? `${withMotion(stateWords(run), motion)} · ${run.experiment}` : `Rig ${withMotion(plain(rig.state), motion)}`)
  $('bar-state').className = `bar-state ${TONE[run?.state ?? rig.state] ?? ''}`
  say($('bar-count'), run ? steadyCountOf(run.trials_stored, run.trials_planned) : '')
  $('bar-count').title = run ? percent(run.trials_stored, run.trials_planned) : ''
  say($('bar-eta'), etaWords(run, at))
  entitle()
  needs(status.needs)
})

/** The title of the tab: what the rig does, but never an old state as if it were the present one. */
function entitle() {
  const { fresh, why, status, motion } = live, { run, rig } = status ?? {}
  const state = !fresh ? why && (/^No status/.test(why) ? 'No status' : 'No connection') : run ? `${run.state} ${percent(run.trials_stored, run.trials_planned)}` : withMotion(plain(rig.state), motion)
  const title = listed([state, PAGES.find(page => page.name === document.body.dataset.page)?.title ?? 'Unknown page', 'Palpate'], ' · ')
  if (document.title !== title) document.title = title
}

// What the button of a need does, where a page can do it.
const DOES = {
  reset: () => actor('Reset', said, () => mend('reset')), home: () => actor('Home', said, () => mend('home'), { sure: sureHome, done: 'accepted' }),
  weights: ({ page }) => link(`/${page}`, 'Go to the weights'), start: ({ page }) => link(`/${page}`, 'Go to the queue'),
}
const DANGERS = ['not_stopped', 'tips_not_raised', 'reset']

/** A need with its time, if the one before it has another. */
function sinceThen({ words, since }, i, all) {
  return since && since !== all[i - 1]?.since ? `${words} Since ${moment(since)}.` : words
}

/** What a person must do, above everything else: the service decides what, and in which order. */
function needs(all) {
  const shown = all.filter(need => need.importance === 'act'), does = shown.find(need => DOES[need.kind])
  const box = $('needs'), text = shown.map(sinceThen).join(' '), first = shown[0]?.kind ?? '', buttons = does?.kind ?? ''
  const isOther = (box.dataset.buttons ?? '') !== buttons, tone = `notice ${shown.some(need => DANGERS.includes(need.kind)) ? 'bad' : 'warn'}`
  if (box.dataset.first !== first) box.dataset.first = first
  if (box.className !== tone) box.className = tone
  say(needed, text)
  if (isOther) {
    box.dataset.buttons = buttons
    said.tell('') // What came of another button would be read as of this one.
    fill(repair, does && DOES[buttons](does))
  }
  if (box.hidden === Boolean(text)) box.hidden = !text
  if (!repairs || !isOther) return
  repairs = false
  // Not on the next button: a key that is held must not press it.
  if (document.activeElement === document.body) (text ? box : $('main')).focus({ preventScroll: true })
}

live.on('fresh', ({ fresh, why, at, status }) => {
  document.documentElement.dataset.live = fresh ? 'yes' : 'no'
  entitle()
  repair.inert = !fresh // What these buttons are for may be over.
  note($('gone'), fresh || !why ? '' : `${why} since ${clock(at || Date.now())}.${status ? ' What is shown is old.' : ''} Trying again.`)
})

start()
open()
