// The recipes that the program carries, as the form of a training starts from them (experiments/recipes).
// The service has no list of them: this is a copy, and what is sent stays visible and editable.

const net = (name, dataset, kind, { map, epochs, batch = 64, patience, beta1, schedule, more = [], noise }) =>
  [
    `name = "${name}"`,
    dataset && `dataset = "${dataset}"`,
    map && `map = "${map}"`,
    '',
    '[training]',
    'seed = 1',
    `epochs = ${epochs}`,
    `batch = ${batch}`,
    patience && `patience = ${patience}`,
    '',
    '[training.net]',
    `kind = "${kind}"`,
    ...more,
    '',
    '[training.optimiser]',
    'learning_rate = 1e-3',
    `beta1 = ${beta1}`,
    schedule && `schedule = "${schedule}"`,
    ...(noise ? ['', '[training.noise]', noise] : []),
    '',
  ]
    .filter(line => line != null && line !== false && line !== undefined)
    .join('\n')

/** Recipes by name: what each learns, and its text. */
export const RECIPES = {
  'transfer-net': {
    about: 'Measured to simulated voltages, in residual form.',
    text: net('transfer-net', 'r2s-transfer', 'transfer-net', { epochs: 30, patience: 8, beta1: 0.9, schedule: 'cosine', more: ['form = "residual"'] }),
  },
  'transfer-net-published': {
    about: 'Measured to simulated voltages, as published (paper, V-A): 1024 epochs.',
    text: net('transfer-net-published', 'r2s-transfer', 'transfer-net', { epochs: 1024, beta1: 0.7, more: ['form = "plain"'] }),
  },
  'recon-net': {
    about: 'Simulated voltages to a force map (paper, V-B).',
    text: net('recon-net', 's2s-recon', 'recon-net', { map: '4x20', epochs: 30, patience: 5, beta1: 0.7, more: ['side = 160', 'upsampling = "apart"'] }),
  },
  'end-to-end': {
    about: 'Measured voltages directly to a force map: the paper\u2019s baseline (V-D).',
    text: net('end-to-end', 'real', 'end-to-end', { map: '4x20', epochs: 30, patience: 5, beta1: 0.7, more: ['side = 160', 'upsampling = "apart"'] }),
  },
  'point-net': {
    about: 'Presence and force at each point, learned from simulations of the serving skin: needs no dataset.',
    text: net('point-net', null, 'point-net', { epochs: 20, batch: 256, beta1: 0.9, schedule: 'cosine', noise: 'white_v = 1.2e-3' }),
  },
}

/** Whether a recipe's answers are force maps. */
export const hasMap = name => ['recon-net', 'end-to-end'].includes(name)
/** Pixels of a map's side: the map covers 640 mm. */
export const side = map => Math.round(640 / Number(map.split('x')[0]))
/** Up to this many pixels of a side fewer channels do, as the command sets them. */
export const FEW = { pixels: 64, channels: '[128, 64, 32]' }
