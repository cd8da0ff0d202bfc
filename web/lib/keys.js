// The keys of the service: who has one, a new one shown once, and the revocation. For admins.

import { all, ask, send } from './api.js'
import { actor, confirm } from './actions.js'
import { copyButton } from './copybutton.js'
import { button, el, field, fill, panel, select } from './dom.js'
import { moment, plain } from './format.js'
import { table } from './table.js'
import { vocabulary } from './vocabulary.js'

/** Makes the panel of the keys. */
export function keys(said, signal) {
  const made = el('div', { className: 'new-key', hidden: true }), name = el('input', { id: 'key-name', maxLength: 100, autocomplete: 'off', required: true }),
    list = el('div')
  const role = select(vocabulary.roles.map(({ name, about }) => [name, `${name}: ${about}`]), 'viewer', () => {}, { id: 'key-role' })
  const create = actor('Make a key', said, async () => {
    if (!name.value.trim()) throw new Error('enter the name of its holder first')
    const { key, secret } = await send('/keys', { name: name.value.trim(), role: role.value }, { signal })
    name.value = ''
    fill(made, el('p', {}, `Key of ${key.name}, ${key.role}. It is shown only now: copy it and hand it over.`), el('pre', { tabIndex: 0 }, secret),
      el('div', { className: 'row' }, copyButton(() => secret), button('I have it', () => { fill(made); made.hidden = true }, { className: 'plain' })))
    made.hidden = false
    await load()
  }, { role: 'admin', className: 'main', what: 'Key' })

  const revoking = key => actor('Revoke', said, async () => { await ask(`/api/v1/keys/${key.id}`, { method: 'DELETE' }); await load() }, {
    role: 'admin', className: 'plain bad', what: `Key of ${key.name}`, 'aria-label': `Revoke the key of ${key.name}`,
    sure: () => confirm(`Revoke the key of ${key.name}?`,
      ['Its holder is locked out at once: its streams end within a second.', 'It cannot be restored; a new key can be made.'], 'Revoke it') })
  const shown = table({
    empty: 'No key yet. Without keys only callers on this machine are admitted.',
    columns: [{ head: 'Name', cell: key => key.name }, { head: 'Role', cell: key => key.role, left: true },
      { head: 'Made', cell: key => moment(key.created_at) }, { head: 'Last used', cell: key => key.last_used_at ? moment(key.last_used_at) : 'never' },
      { head: 'State', left: true, cell: key => key.revoked_at ? `revoked ${moment(key.revoked_at)}` : 'valid' },
      { head: 'Revoke', cell: key => key.revoked_at ? '' : revoking(key) }],
  })
  const node = panel('Keys', {}, list, el('div', { className: 'form' },
    field('Name of the holder, or the purpose', name), field('Rights', role)),
    el('div', { className: 'row' }, create), made)
  async function load() {
    try {
      shown.show(await all('/keys', {}, { signal }))
      fill(list, shown.node)
    } catch (error) { if (!signal.aborted) fill(list, el('p', { className: 'soft' }, `The keys could not be read: ${plain(error.message)}`)) }
  }
  return { node, load }
}
