// Settings: who may do what? Your name and key, the operator lock, the keys of others, the log of actions, and
// what runs here and how it is reached.

import { ask, giveKey, hasKey, person } from '../lib/api.js'
import { actor, only, outcome } from '../lib/actions.js'
import { actionLog } from '../lib/actionlog.js'
import { copyButton } from '../lib/copybutton.js'
import { button, el, facts, form, note, panel, renew, say } from '../lib/dom.js'
import { capital, count, moment } from '../lib/format.js'
import { keys } from '../lib/keys.js'
import { live, who } from '../lib/live.js'
import { mayRelease } from '../lib/lock.js'
import { shows } from '../lib/save.js'
import { vocabulary } from '../lib/vocabulary.js'

/** Rights of a role, with those of the roles before it. */
function rightsOf(role) {
  const until = vocabulary.roles.findIndex(({ name }) => name === role)
  return capital(vocabulary.roles.slice(0, until + 1).map(({ about }) => about).join('; '))
}

/** Shows the page. */
export async function show(root, { query, signal, set }) {
  const log = actionLog(signal), saidKeys = outcome(), key = keys(saidKeys, signal), others = reach(),
    keyPart = el('div', { className: 'columns two' }, key.node, others), you = yourself(), lock = operatorLock(signal, () => log.load({ again: true })),
    service = el('div')
  key.node.append(saidKeys.node)
  const runInput = el('input', { id: 'log-run', type: 'number', min: 1, value: query.run ?? '', className: 'short',
    onchange: () => set({ run: runInput.value }) })
  log.node.querySelector('h2').after(el('div', { className: 'row' }, el('label', { className: 'inline', htmlFor: 'log-run' }, 'Only of run'), runInput,
    button('Read again', () => log.load({ again: true }), { className: 'plain' })))
  root.append(el('div', { className: 'columns three' }, you.node, lock.node, panel('This service', { className: 'live' }, service)), keyPart, log.node)
  log.load({ run: query.run ?? '' })

  const rights = () => {
    key.node.hidden = !live.may('admin')
    keyPart.classList.toggle('two', live.may('admin'))
    you.show()
    if (live.may('admin')) key.load()
    if (live.status) lock.show(live.status.lock)
  }
  rights()
  live.addEventListener('caller', rights, { signal })
  live.on('status', ({ status }) => { lock.show(status.lock); drawService(service, status) }, signal)
  return { update(next) { runInput.value = next.run ?? ''; log.load({ run: next.run ?? '', again: true }) } }
}

/** Name and key of this browser. */
function yourself() {
  const name = el('input', { id: 'my-name', maxLength: 80, autocomplete: 'name', value: person.name }), kept = el('p', { className: 'soft', role: 'status' })
  const secret = el('input', { id: 'my-key', type: 'password', autocomplete: 'off' }), rights = el('p', {}), role = el('p', { className: 'big' })
  const keep = () => {
    person.name = name.value
    say(kept, person.name ? `Kept: actions are logged as ${who()}.` : 'No name: it is asked for at the next action.')
  }
  const give = () => {
    if (!secret.value) return say(kept, 'Enter a key first.')
    const wrong = giveKey(secret.value)
    if (!wrong) secret.value = ''
    say(kept, wrong || 'The key is used from now on. It stays in this tab.')
  }
  const forget = button('Forget the key', () => { giveKey(''); say(kept, 'Forgotten. Requests go without a key.') }, { className: 'plain' })
  const node = panel('You', {}, role, rights,
    form(keep, {}, el('label', { htmlFor: 'my-name' }, 'Your name, logged with every action'),
      el('div', { className: 'row' }, name, el('button', {}, 'Keep'))),
    form(give, {}, el('label', { htmlFor: 'my-key' }, 'Your key of this service'),
      el('div', { className: 'row' }, secret, el('button', {}, 'Use'), forget)), kept)
  function show() {
    const { caller } = live
    say(role, caller ? `${caller.name ?? (person.name ? `${person.name} (local)` : 'A caller on this machine')}, ${caller.role}` : 'Role not known yet')
    say(rights, rightsOf(caller?.role))
    forget.hidden = !hasKey()
  }
  return { node, show }
}

/** The operator lock: who holds it, take it with a note, release it. Changed only if it is still as shown. */
function operatorLock(signal, done) {
  const said = outcome(), words = el('p', { className: 'big' }), noted = el('p'),
    text = el('input', { id: 'lock-note', maxLength: 500, placeholder: 'hands in the rig' })
  const tag = async () => (await ask('/api/v1/lock', { signal })).headers.get('etag')
  let seen = null, held = undefined
  const change = async (method, body, query = '') => {
    const fresh = await tag()
    // What the person saw is what is changed: a lock taken meanwhile is refused by its tag.
    await ask(`/api/v1/lock${query}`, { method, body, headers: { 'if-match': seen ?? fresh }, signal })
    seen = await tag()
    done()
  }
  const take = actor('Take the lock', said, () => change('PUT', { holder: who(), note: text.value || 'no reason given' }),
    { what: 'Lock', locks: false, className: 'main' })
  const free = actor('Release it', said, () => change('DELETE', undefined, `?who=${encodeURIComponent(who())}`), { what: 'Release', locks: false })
  const form = only('operator', el('div', {}, el('label', { htmlFor: 'lock-note' }, 'Why, for the others'), text))
  const node = panel('Operator lock', { className: 'live' }, words, noted, form, el('div', { className: 'row' }, take, free), said.node,
    el('p', { className: 'soft small' }, 'It keeps others from starting, editing and moving, never from stopping. ',
      'Taken without a key it holds for every caller, its holder included, until a caller without a key or an admin releases it.'))
  return { node, show(lock) {
    free.hidden = !lock || !mayRelease(lock)
    const now = JSON.stringify(lock ?? null)
    if (now === held) return
    held = now
    tag().then(etag => { seen = etag }, () => {})
    say(words, lock ? `Held by ${lock.holder}` : 'Free')
    words.className = `big ${lock ? 'warn' : ''}`
    note(noted, lock ? `${lock.note} (since ${moment(lock.since)})` : '')
    form.hidden = take.hidden = Boolean(lock)
  } }
}

function drawService(node, { service, rig, queue_length: waiting }) {
  renew(node, [service, rig.name, waiting], () => [facts([['Version', service.version], ['Commit', service.git_commit?.slice(0, 10) ?? 'not known'], ['Running since', moment(service.started_at)],
    ['Process', String(service.pid)],
    ['Wrong keys', service.wrong_keys ? el('span', { className: 'warn' }, `${count(service.wrong_keys)}, last ${moment(service.wrong_key_at)}`) : 'none'],
      ['Queue', count(waiting)]]),
  facts([['Data', el('code', {}, service.database)]], { className: 'facts one' }),
  el('p', {}, el('a', { href: '/docs', target: '_blank', rel: 'noopener' }, 'Description of the API'), ', with its limits at each request · ',
    shows('metrics', '/metrics', 'metrics.txt')),
  el('p', { className: 'soft small' }, 'A refusal always names the limit that it met.')])
}

/** How other machines reach the service: words, and the commands to copy. */
function reach() {
  const lines = text => el('div', { className: 'command' }, el('pre', { tabIndex: 0 }, text), copyButton(() => text))
  return panel('From other machines', {},
    el('p', {}, `This page is at ${location.origin}. ${/^(localhost|127\.|\[::1\])/.test(location.hostname) ? 'That address is of this machine alone.' : ''}`),
    el('p', {}, 'To open it to a lab: make a key for each person who needs one, then let the service listen on the network.'),
      lines('palpate key create ada --role admin'), lines('palpate serve --bind 0.0.0.0:8080 --tls-cert cert.pem --tls-key key.pem'),
    el('p', {}, 'Every request from outside needs a key. Without the two TLS files, keys and data are sent unencrypted. ',
      'Do not restart the service during a run: it is interrupted, and resumes only if its policy allows.'),
    el('p', { className: 'soft' }, 'Another way that changes nothing here, from the other machine:'), lines(`ssh -L 8080:${location.host} USER@RIG`))
}
