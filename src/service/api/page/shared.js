// Shared by all pages: elements and numbers, requests with a key, the stop. It stands at the begin of the page's
// module. Uses the HTTP API alone.
const $ = id => document.getElementById(id), NONE = '–', sleep = ms => new Promise(resolve => setTimeout(resolve, ms))
const el = (tag, more, ...inside) => { const e = Object.assign(document.createElement(tag), more); e.append(...inside); return e }
const put = texts => { for (const [id, text] of Object.entries(texts)) if ($(id).textContent !== text) $(id).textContent = text }
const note = (id, text) => { put({ [id]: text }); $(id).hidden = !text }, plain = x => typeof x === 'string' ? x.replaceAll('_', ' ') : JSON.stringify(x)
const count = n => n == null ? NONE : n.toLocaleString('en-US'), hms = t => new Date(t).toLocaleTimeString('en-GB')
const fixed = (x, digits, unit = '') => x == null ? NONE : x.toFixed(digits).replace(/^-(?=.*[1-9])/, '\u2212').replace('-', '') + unit
// A browser may forbid storage: the page works without.
const keep = (at, name, value) => { try { return value == null ? window[at].getItem(name) ?? '' : window[at].setItem(name, value) } catch { return '' } }
// The service: every request has a deadline; a refusal carries the problem's own words.
const page = { locked() {}, stopping() {} } // What the page does without a key, and before a stop is sent.
let secret = keep('sessionStorage', 'palpate-key'), locked = false
async function ask(path, { body, method = body ? 'POST' : 'GET', wait = 2000, accept = 'application/json', signal = AbortSignal.timeout(wait) } = {}) {
  const headers = { accept, ...(secret && { authorization: `Bearer ${secret}` }), ...(body && { 'content-type': 'application/json' }) }
  const answer = await fetch(path, { method, headers, body: body && JSON.stringify(body), cache: 'no-store', signal })
  if (answer.ok) return answer
  if (answer.status === 401) needKey()
  const problem = await answer.json().catch(() => ({})), values = (problem.errors ?? []).map(e => `${e.key} = ${e.value}: ${e.limit}`)
  const words = [problem.detail ?? problem.title ?? `the service answered ${answer.status}`, ...values].join('; ')
  throw Object.assign(new Error(words), { status: answer.status })
}
function needKey() { // All but the stop rests until a key is given; the page then loads again.
  locked = true
  put({ 'key-words': secret ? 'That key was refused. The key for this service:' : 'This service asks for a key:' })
  $('key-form').hidden = false
  page.locked()
}
$('key-form').onsubmit = event => {
  event.preventDefault()
  secret = $('key').value
  keep('sessionStorage', 'palpate-key', secret)
  // Without storage the key lasts for this page only: the stop must still have it.
  if (keep('sessionStorage', 'palpate-key') === secret) location.reload()
  else $('key-form').hidden = true
}
// The stop: asks nothing, tries five times, says what came of it.
$('estop').onclick = async () => {
  const name = $('who')?.value.trim() ?? keep('localStorage', 'palpate-who'), body = { why: name ? `pressed on the page by ${name}` : 'pressed on the page' }
  let why = 'it did not latch'
  note('stop-said', 'Stopping…')
  secret ||= $('key').value
  page.stopping() // A browser opens six connections to a service, over all its pages: one must be free now.
  for (let attempt = 0; attempt < 5; attempt++, await sleep(200)) {
    try {
      const { latched } = await (await ask('/api/v1/estop', { body, wait: 1000 })).json()
      if (latched) return note('stop-said', `Emergency stop latched at ${hms(Date.now())}.`)
    } catch (error) { why = error.status ? error.message : 'no answer'; if (error.status < 500) break }
  }
  note('stop-said', `The stop is NOT confirmed (${why}). Use the button on the rig.`)
}
