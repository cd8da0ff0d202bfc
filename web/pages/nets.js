// The nets: "Which models are trained, and which is best?" Serving, models, evaluations side by side, jobs, and the forms that start them.

import { all, get } from '../lib/api.js'
import { only, outcome } from '../lib/actions.js'
import { el, every, fill, panel } from '../lib/dom.js'
import { counted, fixed, moment } from '../lib/format.js'
import { jobView, jobsPanel } from '../lib/jobs.js'
import { listing } from '../lib/listing.js'
import { live } from '../lib/live.js'
import { netView } from '../lib/net.js'
import { evaluationForm, trainingForm } from '../lib/requests.js'
import { scoreTables, shortScore } from '../lib/scores.js'
import { servingPanel } from '../lib/serving.js'
import { table } from '../lib/table.js'
import { meaning } from '../lib/vocabulary.js'

const SERVING_MS = 10_000

/** Shows the page. */
export async function show(root, { query, signal, go }) {
  const known = listing('/models', { words: 'The models', draw: drawModels, limit: 50, signal })
  let models = [],
    datasets = []
  const said = outcome(),
    asked = outcome(),
    toForms = words => (live.may('operator') ? ` ${words}` : '')
  const name = id => models.find(model => model.id === id)?.name ?? id
  const serving = servingPanel({
    signal,
    said,
    name,
    onchange: () => {
      known.read()
      view.forget()
      view.show(query.model)
    },
  })
  const view = netView({ signal, models: () => models, promotion: serving.promotion })
  const work = jobView({ signal, said, models: () => models, onstopped: () => jobs.read() })
  const href = id => `/nets?job=${id}`

  const promote = model => model.slot && serving.promotion(model, { 'aria-label': `Promote ${model.name}, ${model.id}` })
  const list = table({
    href: model => `/nets?model=${model.id}`,
    current: model => [model.id, model.name].includes(query.model),
    empty: () => `No model yet.${toForms('Start a training below, or add one with palpate model add.')}`,
    columns: [
      { head: 'Model', left: true, cell: model => model.name },
      { head: 'Id', left: true, cell: model => el('code', {}, model.id) },
      { head: 'Learned', left: true, cell: model => meaning('tasks', model.task) || model.task },
      { head: 'From', left: true, cell: model => [...(model.manifest.datasets ?? [])].join(', ') || 'simulations' },
      { head: 'Label', left: true, cell: model => model.manifest.label },
      { head: 'Contacts', cell: model => model.manifest.trained_on?.contact_counts?.join(', ') },
      { head: 'Up to', unit: 'N', cell: model => fixed(model.manifest.trained_on?.max_force_n, 0) },
      { head: 'Newest score', left: true, cell: model => (model.scores[0] ? shortScore(model.scores[0]) : 'not evaluated') },
      { head: 'Trained', cell: model => moment(model.created_at) },
      { head: 'Serves', cell: model => (model.serves ? el('span', { className: 'good' }, 'serves') : promote(model)) },
    ],
  })
  const told = el('span')
  const modelsPanel = panel('Models', { aside: told }, known.trouble, list.node, el('div', { className: 'row' }, known.more))

  // Evaluations side by side: what has ended, newest first.
  const scores = el('div')
  const scoresPanel = panel('Evaluations side by side', { aside: el('span', {}, 'as the paper\u2019s Tables III and IV') }, scores)
  function drawScores(jobs) {
    const reports = jobs.filter(job => job.result?.scored).map(job => ({ ...job.result, job: job.id, asked: job.request.dataset })),
      current = one => one.job != null && one.job === query.job
    fill(scores,
      reports.length
        ? scoreTables(reports, models, { href, current })
        : el('p', { className: 'soft' }, `No evaluation has ended yet.${toForms('Start one below.')}`)
    )
  }
  let seen = ''
  const jobs = jobsPanel({
    signal,
    href,
    current: () => query.job,
    onchange: (found, ended) => {
      const key = found.filter(job => job.result).map(job => job.id).join()
      if (key !== seen) {
        seen = key
        drawScores(found)
      }
      if (ended) known.read()
    },
  })
  const onstart = job => {
    jobs.read()
    go(href(job.id))
  }
  const training = trainingForm({ said: asked, onstart, signal }),
    evaluation = evaluationForm({ said: asked, onstart, signal })
  // Both are refused to a viewer.
  const forms = only('operator', el('div', { className: 'columns two' }, training.node, evaluation.node))

  function drawModels() {
    models = known.items
    fill(told, models.length ? `${known.next ? 'first ' : ''}${counted(models.length, 'model')}, newest first` : '')
    list.show(models)
    serving.draw()
    drawScores(jobs.all())
    evaluation.knows({ datasets, models })
  }
  function update(changed) {
    query = changed
    view.show(query.model)
    work.show(query.job)
    list.show(models)
    jobs.redraw()
    drawScores(jobs.all())
    if (query.model || query.job) scrollTo(0, 0)
  }

  root.append(
    el('section', { className: 'asked' }, said.node),
    view.node,
    work.node,
    serving.node,
    modelsPanel,
    scoresPanel,
    jobs.node,
    el('section', { className: 'asked' }, asked.node),
    forms
  )
  /** Names of datasets for the forms: made ones first, then what can be made. */
  async function readDatasets() {
    const found = await all('/datasets', {}, { most: 200, signal }).catch(() => [])
    const built = await get('/datasets', { limit: 1 }, { signal }).then(page => page.definitions, () => [])
    datasets = [...new Set([...found.map(item => item.name), ...built])]
    if (signal.aborted) return
    training.knows({ datasets })
    evaluation.knows({ datasets, models })
  }
  // What the empty lists say depends on the role.
  live.addEventListener('caller', () => {
    list.show(models)
    jobs.redraw()
    drawScores(jobs.all())
  }, { signal })
  view.show(query.model)
  every(SERVING_MS, serving.read, signal)
  readDatasets()
  known.read().then(() => !signal.aborted && work.show(query.job)) // A result names its nets.
  return { update }
}
