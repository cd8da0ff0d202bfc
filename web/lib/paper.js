// Numbers that the paper prints, shown next to what this service measured. Each with its table. No DOM.

/** Table I: trials by the number of contacts, 1 to 6. */
export const TRIALS = { 'real-hex': [20092, 21313, 19712, 14487, 15944, 2126], 'real-random': [0, 50, 50, 50, 0, 0] }

/** Fig. 7F: median FVU of the simulation, read from the figure. */
export const FVU = 0.1

/** Table III: Transfer-Net that learned 1 to 6 contacts; RMSE in V and FVU in % of its test sets of 1 to 6 contacts. */
export const TRANSFER = [[0.004, 5.7], [0.010, 5.4], [0.012, 5.0], [0.010, 2.5], [0.012, 2.3], [0.014, 4.2]]

const score = (number, location, force, diameter) => ({ number_percent: number, location_mm: location, force_percent: force, diameter_percent: diameter })
const spread = (mean, sd) => ({ mean, sd })

/** Table IV: Recon-Net alone, by map (pixel x diameter, mm): mean and standard deviation. */
export const RECON = Object.fromEntries([
  ['4x20', [-22, 23], [11, 22], [-1, 52], [-31, 12]],
  ['4x28', [-18, 22], [11, 18], [-7, 42], [11, 17]],
  ['4x32', [-14, 20], [11, 17], [-3, 42], [36, 18]],
  ['4x44', [-11, 18], [13, 16], [5, 43], [69, 22]],
  ['4x52', [-12, 18], [13, 14], [0, 40], [107, 25]],
  ['4x60', [-12, 19], [15, 15], [-1, 39], [134, 28]],
  ['10x10', [-28, 26], [12, 25], [-18, 44], [-34, 21]],
  ['10x30', [-15, 20], [14, 22], [-2, 42], [19, 17]],
  ['10x50', [-11, 18], [13, 18], [5, 46], [81, 22]],
  ['10x70', [-12, 21], [16, 19], [-2, 41], [171, 28]],
  ['20x20', [-15, 22], [15, 26], [-7, 43], [18, 15]],
  ['20x60', [-4, 26], [23, 36], [-6, 48], [128, 18]],
].map(([map, ...means]) => [map, score(...means.map(mean => spread(...mean)))]))

/** V-D: the whole pipeline on Real-Unseen, the best of 36 (Map 1, noise of 50 %). */
export const UNSEEN = score(...[-58.3, 74.4, 17.2, -9.3].map(mean => spread(mean)))
