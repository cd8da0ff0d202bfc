// The service: requests with a key and a deadline, pages, streams. Knows no page.

import { clock, listed } from './format.js'
import { seen, sleep } from './dom.js'

// A browser may forbid storage: the dashboard works without.
export const keep = (at, name, value) => {
  try { return value == null ? window[at].getItem(name) ?? '' : (window[at].setItem(name, value), value) } catch { return '' }
}
// A header takes no other characters: with one, no request at all would be sent, not even the stop.
const canBeSent = text => text === '' || /^[\x21-\x7e]+$/.test(text)
let secret = keep('sessionStorage', 'palpate-key')
if (!canBeSent(secret)) secret = keep('sessionStorage', 'palpate-key', '')

/** Dispatches `locked` when the service asks for a key, `key` when one was given, `opened` when it answers again. */
export const door = new EventTarget()
export const hasKey = () => secret !== ''
let isLocked = false

/** Takes a key, or none (''); it stays in this tab's storage and in no address. Returns why it cannot be a key, or ''. */
export function giveKey(text) {
  const key = text.trim()
  if (!canBeSent(key)) return 'A key has no spaces and only the characters of a plain English keyboard: this one has another.'
  secret = keep('sessionStorage', 'palpate-key', key)
  door.dispatchEvent(new Event('key'))
  return ''
}

/** A refusal, in the service's own words. */
export class Refused extends Error {
  constructor(status, words, problem = {}) {
    super(words)
    Object.assign(this, { status, problem })
  }
}

/** A request without an answer: it may have been carried out, or may still arrive, when a silent network carries again. */
export class Unanswered extends Error {}

/** A request that a stop ended: it is neither a lost connection nor to be sent again. */
export class Stopped extends Error {
  constructor() { super('the stop ended this request') }
}

// A browser opens six connections to a service: the stop must not wait for one that a slow answer holds.
let others = new AbortController()

/** Sends a request and returns the response. Throws `Refused` with the words of the problem. `keyless` sends no key. */
export async function ask(path, { body, method = body === undefined ? 'GET' : 'POST', wait = 8000, accept = 'application/json', signal, headers = {}, keyless = false } = {}) {
  const sent = keyless ? '' : secret
  const limit = wait ? AbortSignal.timeout(wait) : null
  const ending = path === ESTOP ? null : others.signal, until = [signal, limit, ending].filter(Boolean)
  const form = body instanceof FormData || body instanceof Blob
  const response = await fetch(path, {
    method, cache: 'no-store', priority: path === ESTOP ? 'high' : 'auto', body: form || body === undefined ? body : JSON.stringify(body),
    headers: { accept, ...(sent && { authorization: `Bearer ${sent}` }), ...(body !== undefined && !form && { 'content-type': 'application/json' }), ...headers },
    signal: until.length ? AbortSignal.any(until) : undefined,
  }).catch(error => {
    if (ending?.aborted) throw ending.reason
    if (error.name !== 'AbortError') error = new Unanswered(error.name === 'TimeoutError' ? 'no answer in time' : 'no connection', { cause: error })
    throw error
  })
  if (response.ok || response.status === 304) {
    // The stop may need no key where all else does.
    if (isLocked && sent === secret && path !== ESTOP) { isLocked = false; door.dispatchEvent(new Event('opened')) }
    return response
  }
  const problem = await response.json().catch(() => ({}))
  const values = (problem.errors ?? []).map(e => listed([[e.key, e.value].filter(x => x != null && x !== '').join(' = '), e.limit], ': '))
  const detail = problem.detail ?? problem.title ?? `the service answered ${response.status}`
  const words = [detail, ...values.filter(text => !detail.includes(text))].join('; ')
  // A late answer to another key than the present one says nothing of the present one.
  if (response.status === 401 && !keyless && sent === secret) {
    isLocked = true
    door.dispatchEvent(new CustomEvent('locked', { detail: sent ? 'That key was refused.' : 'This service asks for a key.' }))
  }
  throw new Refused(response.status, words, problem)
}

/** GET as JSON; `query` becomes the parameters, null ones are omitted. */
export async function get(path, query = {}, options = {}) {
  return (await ask(withQuery(`/api/v1${path}`, query), options)).json()
}

/** POST (or another method) as JSON; returns the body of the answer, or null. */
export async function send(path, body = {}, options = {}) {
  const response = await ask(`/api/v1${path}`, { body, wait: 30_000, ...options })
  return response.status === 204 ? null : response.json().catch(() => null)
}

/** A random UUID (RFC 9562, version 4); crypto.randomUUID exists only in a page over https or of this machine. */
function uuid() {
  const bytes = crypto.getRandomValues(new Uint8Array(16))
  bytes[6] = bytes[6] & 0x0f | 0x40
  bytes[8] = bytes[8] & 0x3f | 0x80
  const hex = Array.from(bytes, byte => byte.toString(16).padStart(2, '0')).join('')
  return hex.replace(/^(.{8})(.{4})(.{4})(.{4})/, '$1-$2-$3-$4-')
}

/** Sends a request that starts something: with an Idempotency-Key, repeated if the connection fails, never after a stop. */
export async function once(path, body = {}, options = {}) {
  const headers = { ...options.headers, 'idempotency-key': uuid() }, begun = others
  for (let attempt = 0; ; attempt += 1) {
    try { return await send(path, body, { ...options, headers }) } catch (error) {
      if (error instanceof Refused || error instanceof Stopped || error.name === 'AbortError' || attempt === 2) throw error
      await sleep(500)
      if (begun !== others) throw new Stopped() // A stop since then: what it ended must not move the rig again.
    }
  }
}

/** The rows of an answer in NDJSON. */
export const rowsOf = async answer => (await answer.text()).split('\n').filter(Boolean).map(line => JSON.parse(line))

/** All items of a list, page by page, up to `most`. */
export async function all(path, query = {}, { most = 1000, ...options } = {}) {
  const items = []
  for (let cursor; ;) {
    const page = await get(path, { limit: Math.min(most, 1000), ...query, cursor }, options)
    items.push(...page.items)
    cursor = page.next
    if (!cursor || items.length >= most) return items
  }
}

/** Makes a function that reads once: later calls get the same promise, unless it has failed. */
export function readOnce(read) {
  let asked = null
  return () => {
    asked ??= read()
    asked.catch(() => { asked = null })
    return asked
  }
}

export function withQuery(path, query) {
  const pairs = Object.entries(query).filter(([, value]) => value != null && value !== '')
  return pairs.length ? `${path}?${new URLSearchParams(pairs)}` : path
}

/**
 * Opens a WebSocket; with a key a ticket stands for it. Reconnects until `signal` aborts. `raw` gives
 * the texts unparsed; with `rest` it is closed while the page is hidden.
 */
export async function socket(path, { onmessage, onstate = () => {}, query = {}, signal, raw = false, rest = false }) {
  for (let wait = 500; !signal.aborted; wait = Math.min(2 * wait, 5000)) {
    if (rest) await seen(signal)
    try {
      const ticket = hasKey() ? (await send('/tickets', undefined, { method: 'POST', signal })).ticket : null
      if (signal.aborted) return // While the page was hidden, or the ticket came: nothing would close the socket.
      const url = new URL(withQuery(`/api/v1${path}`, { ...query, ticket }), location.href.replace(/^http/, 'ws'))
      await new Promise(resolve => {
        const open = new WebSocket(url)
        const end = () => open.close(), hide = () => rest && document.hidden && end()
        signal.addEventListener('abort', end, { once: true })
        document.addEventListener('visibilitychange', hide)
        open.onmessage = ({ data }) => { wait = 500; onstate(true); onmessage(raw ? data : JSON.parse(data)) }
        open.onclose = () => { signal.removeEventListener('abort', end); document.removeEventListener('visibilitychange', hide); resolve() }
      })
    } catch { /* Tried again below. */ }
    onstate(false)
    await sleep(wait, signal)
  }
}

// The service sends a comment every 15 s: with none for longer the network is gone, though nothing says so.
const SILENT_MS = 40_000

/** Follows the events from `since` (negative: that many of the newest). Reconnects with the last id. */
export async function follow(since, { onevent, onstate = () => {}, signal }) {
  let last = since
  for (let wait = 1000; !signal.aborted; wait = Math.min(2 * wait, 10_000)) {
    await seen(signal)
    const cut = new AbortController(), hide = () => document.hidden && cut.abort()
    let silent = 0
    const heard = () => { clearTimeout(silent); silent = setTimeout(() => cut.abort(), SILENT_MS) }
    heard()
    document.addEventListener('visibilitychange', hide) // Six connections a browser: a hidden page holds none.
    try {
      const { body } = await ask(withQuery('/api/v1/events', { since: last }), { accept: 'text/event-stream', wait: 0, signal: AbortSignal.any([signal, cut.signal]) })
      onstate(true)
      const reader = body.pipeThrough(new TextDecoderStream()).getReader()
      for (let text = '', part; !(part = await reader.read()).done;) {
        heard()
        const lines = (text + part.value).split(/\r?\n/)
        text = lines.pop()
        for (const line of lines.filter(line => line.startsWith('data:'))) {
          const event = JSON.parse(line.slice(5))
          last = event.seq
          wait = 500
          onevent(event)
        }
      }
    } catch { /* Tried again below. */ }
    clearTimeout(silent)
    document.removeEventListener('visibilitychange', hide)
    if (!document.hidden) onstate(false)
    await sleep(wait, signal)
  }
}

/** The name that actions are logged with; asked for once, kept in this browser. */
export const person = { get name() { return keep('localStorage', 'palpate-who') }, set name(text) { keep('localStorage', 'palpate-who', text.trim()) } }

const ESTOP = '/api/v1/estop'

/** Presses the stop: sends without a question, ends all other requests, tries five times, returns the outcome. */
export async function estop() {
  others.abort(new Stopped())
  others = new AbortController()
  const who = person.name || undefined, why = 'pressed on the page'
  let reason = 'it did not latch', keyless = false
  for (let attempt = 0; attempt < 5; attempt += 1) {
    try {
      const { latched } = await (await ask(ESTOP, { body: { who, why }, wait: 1000, keyless })).json()
      if (latched) return { latched: true, words: `Emergency stop latched at ${clock(Date.now())}.` }
    } catch (error) {
      // With a wrong key the service refuses what it may grant without one.
      const mayWithout = error.status === 401 && !keyless && hasKey()
      if (!keyless || error.status !== 401) reason = error.status ? error.message : 'no answer'
      if (error.status < 500 && !mayWithout) break
      if (mayWithout) { keyless = true; continue }
    }
    await sleep(200)
  }
  return { latched: false, words: `The stop of ${clock(Date.now())} is NOT confirmed (${reason}). Use the button on the rig.` }
}
