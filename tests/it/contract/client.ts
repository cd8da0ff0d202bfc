// A client typed by openapi-typescript makes real calls. Arguments: address of a service, key.
import createClient from 'openapi-fetch'
import type { components, paths } from './api.js'

const [url, key] = process.argv.slice(2)
const client = createClient<paths>({ baseUrl: url, headers: { authorization: `Bearer ${key}` } })
const must = <T>(value: T | undefined, what: string): T => {
  if (value === undefined) throw new Error(`${what}: no answer`)
  return value
}

const status = await client.GET('/api/v1/status')
const service: components['schemas']['ServiceInfo'] = must(status.data, 'status').service
if (service.pid <= 0) throw new Error(`pid ${service.pid}`)
const runs = await client.GET('/api/v1/runs', { params: { query: { limit: 1 } } })
const run = must(runs.data, 'runs').items[0]
const trials = await client.GET('/api/v1/runs/{run}/trials', { params: { path: { run: run.uid }, query: { limit: 2 } } })
const page = must(trials.data, 'trials') as components['schemas']['Page_TrialRow']
const ids: number[] = page.items.map(trial => Number(trial.trial_id))
if (ids.length !== 2) throw new Error(`trials ${ids}`)
const lock = await client.PUT('/api/v1/lock', { body: { note: 'typed' } })
if (must(lock.data, 'lock').note !== 'typed') throw new Error('lock')
await client.DELETE('/api/v1/lock')
const none = await client.GET('/api/v1/runs/{run}', { params: { path: { run: '999999' } } })
const problem: components['schemas']['ProblemBody'] = must(none.error, 'a problem')
if (problem.status !== 404) throw new Error(JSON.stringify(problem))
console.log('6 calls')
