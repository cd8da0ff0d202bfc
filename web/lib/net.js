// One model in full: what it learned from, its losses, its scores, the residuals of a Transfer-Net, its file.

import { Refused, ask, get } from './api.js'
import { el, facts, fill, link, note, panel, pane, say } from './dom.js'
import { NONE, bytes, count, counted, fixed, listed, moment } from './format.js'
import { frame } from './frame.js'
import { losses } from './losses.js'
import { opened, openedHead } from './opened.js'
import { save, shows } from './save.js'
import { scoreTables } from './scores.js'
import { meaning } from './vocabulary.js'

/** Makes the view of one model; ends what it began when another one is shown. `promotion(model, props)` makes its button. */
export function netView({ signal, models, promotion }) {
  return opened({ className: 'net', signal, draw: read, back: ['/nets', 'All nets'] })

  async function read(node, id, mine) {
    const model = await get(`/models/${encodeURIComponent(id)}`, {}, { signal: mine })
    if (!mine.aborted) draw(node, model, mine)
  }

  function draw(node, model, mine) {
    const { manifest } = model,
      label = () => manifest.label,
      learned = manifest.trained_on ?? {}
    const size = el('span', {}, '…'),
      promoting = model.slot && promotion(model, { className: 'main' })
    ask(`/api/v1/models/${model.id}/onnx`, { method: 'HEAD', accept: '*/*', signal: mine }).then(
      answer => say(size, bytes(Number(answer.headers.get('content-length')) || null)),
      () => say(size, NONE)
    )
    const range = listed([
      learned.contact_counts?.length && `${learned.contact_counts.join(', ')} contacts`,
      learned.max_force_n != null && `up to ${fixed(learned.max_force_n, 1, 'N')}`,
      learned.max_norm_v != null && `frames up to ${fixed(learned.max_norm_v, 1, 'V')}`,
    ])
    const head = el('section', { 'aria-label': model.name },
      openedHead(model.name, model.id, '/nets'),
      el('p', {},
        `From ${meaning('tasks', model.task) || model.task}; learned on ${manifest.label} data of ${manifest.sensor}. `,
        model.serves ? el('span', { className: 'good' }, 'It serves.') : 'It does not serve.'
      ),
      facts([
        ['Trained', moment(model.created_at, true)],
        ['Size', size],
        ['Output', (manifest.output_shape ?? []).join(' x ')],
        manifest.force_map && ['Force map, mm', manifest.force_map],
        ['Channels', count(manifest.channels)],
      ]),
      el('p', {},
        'Datasets: ',
        manifest.datasets?.length
          ? manifest.datasets.map((id, i) => [i ? ', ' : '', link(`/data?dataset=${id}`, id)])
          : 'none, simulations made during the training',
        '. ',
        range && `Trained range: ${range}; a frame outside it is answered, and the answer says so.`
      ),
      el('p', { className: 'soft small' },
        listed([
          manifest.simulation && `Twins: ${manifest.simulation}.`,
          manifest.calibration && `Calibration: ${manifest.calibration}.`,
          manifest.code && `Code: ${manifest.code}.`,
        ], ' ')
      ),
      el('div', { className: 'row' },
        !model.serves && promoting,
        save('ONNX file', `/api/v1/models/${model.id}/onnx`, `${model.name}-${model.id}.onnx`),
        shows('JSON', `/api/v1/models/${model.id}`, `${model.name}-${model.id}.json`)
      )
    )
    const curves = losses({ path: `/models/${model.id}/losses`, label, signal: mine })
    const recipe = panel('Recipe', {},
      manifest.recipe ? el('pre', { tabIndex: 0 }, manifest.recipe.trim()) : el('p', { className: 'soft' }, 'It was added from a file: no recipe is known.')
    )
    const scores = panel('Scores', { aside: el('span', {}, counted(model.scores.length, 'evaluation')) },
      scoreTables(model.scores, models()),
      model.scores.length ? '' : el('p', { className: 'soft' }, 'It was not evaluated yet.')
    )
    fill(node,
      head,
      el('div', { className: 'columns two' }, pane(curves.node), recipe),
      scores,
      model.task === 'transfer' ? residuals(model, label, mine) : ''
    )
  }
}

const mv = volts => fixed(volts * 1e3, 1, 'mV')

/** Fig. 10A: mean and standard deviation of the transfer error, channel by channel. */
function residuals(model, label, signal) {
  const said = el('p', { className: 'soft' }, 'Computing the residuals …'),
    path = `/models/${model.id}/residuals`
  const pictures = el('div', { className: 'pair residuals', hidden: true })
  get(path, {}, { signal, wait: 120_000 }).then(
    ({ mean_v, sd_v, trials }) => {
      const top = values => values.reduce((a, v) => Math.max(a, Math.abs(v)), 0),
        rms = Math.sqrt(sd_v.reduce((sum, v, i) => sum + v * v + mean_v[i] ** 2, 0) / sd_v.length)
      for (const [title, values] of [['Mean of the transfer error', mean_v], ['Standard deviation', sd_v]]) {
        const one = frame({ title, name: `${model.id}-${title === 'Standard deviation' ? 'sd' : 'mean'}`, label, query: `/api/v1${path}`, signal })
        pictures.append(one.node)
        one.show(values)
      }
      pictures.hidden = false
      note(
        said,
        `Over ${counted(trials, 'trial')} outside its training part. Largest mean ${mv(top(mean_v))}, largest standard deviation ${mv(top(sd_v))}, ` +
          `root mean square ${mv(rms)}. This is the noise that a Recon-Net is trained with.`
      )
    },
    error => {
      if (!signal.aborted) note(said, error instanceof Refused ? `No residuals: ${error.message}` : 'The residuals could not be read.')
    }
  )
  return panel('Residuals', { aside: el('span', {}, 'as in the paper\u2019s Fig. 10A') }, said, pictures)
}
