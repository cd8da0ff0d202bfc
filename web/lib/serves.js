// What serves: which method has its models, and how to get one where none has. Live and the nets ask this.

import { el, facts, link, panel, renew } from './dom.js'
import { capital } from './format.js'
import { vocabulary } from './vocabulary.js'

/** A slot by its name. */
export const slotOf = name => vocabulary.slots.find(slot => slot.name === name)

/** The slot of the nets with a task, whatever their sensor. */
export const slotOfTask = task => vocabulary.slots.find(slot => slot.tasks.includes(task))

/** Whether a slot is for nets that answer a quantity of a whole frame: no method uses them. */
export const isOfQuantity = slot => !slot.methods.length

/** Slots that a method needs and that are empty; `serving` is the body of GET /serving. */
export const lacks = (method, serving) => method.needs.filter(slot => !serving?.serves.find(one => one.slot === slot)?.what)

/** The slots of quantities whose nets serve. */
export const servedQuantities = serving => vocabulary.slots.filter(slot => isOfQuantity(slot) && serving?.serves.some(one => one.slot === slot.name && one.what))

/** The best method that has all its models, or null. */
export const bestMethod = serving => vocabulary.methods.findLast(method => !lacks(method, serving).length) ?? null

/** needs a Point-Net */
export const needWords = (method, serving) => `needs a ${lacks(method, serving).map(slot => slotOf(slot).title).join(' and a ')}`

/** Makes a panel of what serves, and one (`none`) that says how to get a model while there is none. */
export function servingPart() {
  const list = el('div'), none = el('div')
  const row = (method, serving) => {
    const ready = !lacks(method, serving).length
    return el('li', { className: ready ? '' : 'soft' }, el('b', {}, method.name), `, ${method.about}: `, ready ? 'serves' : needWords(method, serving))
  }
  return {
    node: panel('Active models', { className: 'live' }, list), none,
    show(serving) {
      renew(list, serving.serves, () => {
        const filled = serving.serves.filter(one => one.what)
        const models = filled.map(one => [capital(slotOf(one.slot).title), link('/nets', one.what)])
        const limits = filled.filter(one => one.limitation).map(one => el('p', { className: 'soft' }, `${capital(slotOf(one.slot).title)}: ${one.limitation}`))
        return [el('ul', {}, vocabulary.methods.map(method => row(method, serving))), facts(models, { className: 'facts one' }), limits]
      })
      renew(none, serving.serves, () => !bestMethod(serving) && howTo(servedQuantities(serving)))
    },
    failed: ({ message }) => renew(list, message, () => el('p', { className: 'soft' }, `The active models cannot be read: ${message}`)),
  }
}

// The methods that need models of a net, or none.
const methodsBy = wanted => vocabulary.methods.filter(method => method.needs.some(slot => slotOf(slot).tasks.length) === wanted).map(method => method.name).join(', ')

/** How contacts are estimated; `quantities`: the slots of the nets that answer already, which do not. */
const howTo = quantities => panel(quantities.length ? 'Contacts are not estimated yet' : 'No model serves yet', { className: 'welcome' },
  el('p', {}, quantities.length ? `The ${quantities.map(slot => slot.title).join(' and the ')} ${quantities.length === 1 ? 'serves' : 'serve'}: see Quantities. `
    + 'Where the skin is touched, and with which force, needs another model. There are two ways to get it:'
    : 'Nothing states yet what touches the skin. There are two ways to get it:'),
  el('ol', { className: 'steps' },
    el('li', {}, 'Fit the model to this skin from a stored run with ', el('code', {}, 'palpate calibrate skin --run 1 --out skin.toml'),
      `, then add and promote the file. Methods that then work: ${methodsBy(false)}.`),
    el('li', {}, 'Train a net on a dataset and promote it: ', link('/nets', 'the nets'), `. Methods that then work: ${methodsBy(true)}.`)))
