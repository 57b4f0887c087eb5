// The core of CartPole: step.py in hardware, with its names. Pipelined, a slot a cycle.

// verilator lint_off DECLFILENAME
package cart_pole_pkg;
  // verilator lint_on DECLFILENAME

  import pearl_fixed_pkg::*;

  // Start, turns | sine and cosine | push, torque | reciprocal | swing, reaction | kick, sums.
  localparam int unsigned LATENCY = 6 * MULTIPLY_LATENCY + SINE_COSINE_LATENCY + RECIPROCAL_LATENCY + 2;
  localparam int unsigned II = 1;

  localparam int unsigned STATE_BITS = 128;
  localparam int unsigned ACTION_BITS = 1;
  localparam int unsigned OBS_BITS = 128;
  localparam int unsigned REWARD_BITS = 1;

  // A state word, the first field of the spec last.
  typedef struct packed {
    fixed_t angular_velocity;
    fixed_t angle;
    fixed_t velocity;
    fixed_t position;
  } state_t;

endpackage

module cart_pole_pe
  import cart_pole_pkg::*;
  import pearl_fixed_pkg::*;
#(
    // Whether the reward is the category 1 at the end of an episode.
    parameter bit SUTTON_BARTO_REWARD = 1'b0
) (
    input logic               clk_i,
    input logic               rst_ni,
    input logic               valid_i,
    // Start from the initial state, not from state_i.
    input logic               first_i,
    // Do not step: the result is the state started from and its observation.
    input logic               hold_i,
    input state_t             state_i,
    input logic               action_i,
    // The random draws of this slot and step, those for the initial state first.
    input logic   [3:0][31:0] rng_i,

    output logic           valid_o,
    output state_t         state_o,
    output logic   [127:0] obs_o,
    output logic           reward_o,
    output logic           terminated_o
);

  // The constants of step.py.
  localparam fixed_t TURNS = 32'sd1367130551;
  localparam fixed_t TAU = 32'sd1374389535;
  localparam fixed_t PUSH = 32'sd195225786;
  localparam fixed_t SPIN = 32'sd1999112051;
  localparam fixed_t WEIGHT = 32'sd210453398;
  localparam fixed_t SHARE = 32'sd1561806289;
  localparam fixed_t FOUR_THIRDS = 32'sd1431655765;
  localparam fixed_t TRACK = 32'sd322122547;
  localparam fixed_t LEAN = 32'sd28110495;
  localparam fixed_t START = 32'sd13421772;

  // Cycles after the inputs at which things are known.
  localparam int unsigned AT_FROM = MULTIPLY_LATENCY;
  localparam int unsigned AT_MOVED = AT_FROM + MULTIPLY_LATENCY + 1;
  localparam int unsigned AT_SPIN = AT_FROM + 2 * MULTIPLY_LATENCY;
  localparam int unsigned AT_SINE = AT_FROM + MULTIPLY_LATENCY + SINE_COSINE_LATENCY;
  localparam int unsigned AT_PUSH = AT_SINE + MULTIPLY_LATENCY;
  localparam int unsigned AT_TORQUE = AT_PUSH + MULTIPLY_LATENCY;
  localparam int unsigned AT_RECIPROCAL = AT_TORQUE + RECIPROCAL_LATENCY;
  localparam int unsigned AT_SWING = AT_RECIPROCAL + MULTIPLY_LATENCY;
  localparam int unsigned AT_REACTION = AT_SWING + MULTIPLY_LATENCY;
  localparam int unsigned AT_KICK = AT_REACTION + 1;

  logic [LATENCY-1:0] valid_q;
  always_ff @(posedge clk_i or negedge rst_ni) begin
    if (!rst_ni) valid_q <= '0;
    else valid_q <= {valid_q[LATENCY-2:0], valid_i};
  end

  // Where the slot starts from.
  state_t start, state, from;
  logic first, hold, right;

  fixed_t [3:0] started;
  for (genvar i = 0; i < 4; i++) begin : gen_start
    pearl_fixed_multiply #(
        .SHIFT(32)
    ) u_start (
        .clk_i,
        .a_i(rng_i[i]),
        .b_i(START),
        .product_o(started[i])
    );
  end
  assign start = started;

  pearl_delay #(
      .WIDTH (STATE_BITS + 2),
      .STAGES(AT_FROM)
  ) u_from (
      .clk_i,
      .d_i({first_i, hold_i, state_i}),
      .d_o({first, hold, state})
  );
  pearl_delay #(
      .WIDTH (1),
      .STAGES(AT_PUSH)
  ) u_right (
      .clk_i,
      .d_i(action_i),
      .d_o(right)
  );
  assign from = first ? start : state;

  // Position and angle need nothing but the velocities.
  fixed_t way, turn, moved_q, turned_q;
  state_t from_late;
  logic hold_late, terminated_q;

  pearl_fixed_multiply #(
      .SHIFT(36)
  ) u_way (
      .clk_i,
      .a_i(from.velocity),
      .b_i(TAU),
      .product_o(way)
  );
  pearl_fixed_multiply #(
      .SHIFT(36)
  ) u_turn (
      .clk_i,
      .a_i(from.angular_velocity),
      .b_i(TAU),
      .product_o(turn)
  );
  pearl_delay #(
      .WIDTH (STATE_BITS + 1),
      .STAGES(MULTIPLY_LATENCY)
  ) u_from_late (
      .clk_i,
      .d_i({hold, from}),
      .d_o({hold_late, from_late})
  );

  logic hold_q;
  fixed_t velocity_q, angular_velocity_q;
  always_ff @(posedge clk_i) begin
    hold_q <= hold_late;
    velocity_q <= from_late.velocity;
    angular_velocity_q <= from_late.angular_velocity;
    moved_q <= hold_late ? from_late.position : saturate(33'(from_late.position) + 33'(way));
    turned_q <= hold_late ? from_late.angle : saturate(33'(from_late.angle) + 33'(turn));
  end

  // Sine and cosine of the angle, and the square of the angular velocity meanwhile.
  fixed_t turns, sine, cosine, spin_half, spin, spin_late;

  pearl_fixed_multiply #(
      .SHIFT(28)
  ) u_turns (
      .clk_i,
      .a_i(from.angle),
      .b_i(TURNS),
      .product_o(turns)
  );
  pearl_sine_cosine u_sine_cosine (
      .clk_i,
      .turns_i (turns),
      .sine_o  (sine),
      .cosine_o(cosine)
  );
  pearl_fixed_multiply #(
      .SHIFT(32)
  ) u_spin_half (
      .clk_i,
      .a_i(from.angular_velocity),
      .b_i(SPIN),
      .product_o(spin_half)
  );
  pearl_fixed_multiply #(
      .SHIFT(33)
  ) u_spin (
      .clk_i,
      .a_i(spin_half),
      .b_i(from_late.angular_velocity),
      .product_o(spin)
  );
  pearl_delay #(
      .WIDTH (32),
      .STAGES(AT_SINE - AT_SPIN)
  ) u_spin_late (
      .clk_i,
      .d_i(spin),
      .d_o(spin_late)
  );

  // What pushes the cart, and what turns the pole.
  fixed_t centrifugal, push, pole, weight, cosine_late, lever, inertia, pull, weight_late, torque;

  pearl_fixed_multiply #(
      .SHIFT(30)
  ) u_centrifugal (
      .clk_i,
      .a_i(spin_late),
      .b_i(sine),
      .product_o(centrifugal)
  );
  assign push = (right ? PUSH : -PUSH) + centrifugal;
  pearl_fixed_multiply #(
      .SHIFT(31)
  ) u_pole (
      .clk_i,
      .a_i(cosine),
      .b_i(SHARE),
      .product_o(pole)
  );
  pearl_fixed_multiply #(
      .SHIFT(30)
  ) u_weight (
      .clk_i,
      .a_i(sine),
      .b_i(WEIGHT),
      .product_o(weight)
  );
  pearl_delay #(
      .WIDTH (32),
      .STAGES(MULTIPLY_LATENCY)
  ) u_cosine_late (
      .clk_i,
      .d_i(cosine),
      .d_o(cosine_late)
  );

  pearl_fixed_multiply #(
      .SHIFT(33)
  ) u_lever (
      .clk_i,
      .a_i(pole),
      .b_i(cosine_late),
      .product_o(lever)
  );
  assign inertia = FOUR_THIRDS - lever;
  pearl_fixed_multiply #(
      .SHIFT(30)
  ) u_pull (
      .clk_i,
      .a_i(cosine_late),
      .b_i(push),
      .product_o(pull)
  );
  pearl_delay #(
      .WIDTH (32),
      .STAGES(MULTIPLY_LATENCY)
  ) u_weight_late (
      .clk_i,
      .d_i(weight),
      .d_o(weight_late)
  );
  assign torque = weight_late - pull;

  // The pole's answer, and what of it the cart feels.
  fixed_t by_inertia, torque_late, swing, pole_late, reaction, push_late;

  pearl_reciprocal u_reciprocal (
      .clk_i,
      .x_i(inertia),
      .reciprocal_o(by_inertia)
  );
  pearl_delay #(
      .WIDTH (32),
      .STAGES(AT_RECIPROCAL - AT_TORQUE)
  ) u_torque_late (
      .clk_i,
      .d_i(torque),
      .d_o(torque_late)
  );
  pearl_fixed_multiply #(
      .SHIFT(29)
  ) u_swing (
      .clk_i,
      .a_i(torque_late),
      .b_i(by_inertia),
      .product_o(swing)
  );
  pearl_delay #(
      .WIDTH (32),
      .STAGES(AT_SWING - AT_PUSH)
  ) u_pole_late (
      .clk_i,
      .d_i(pole),
      .d_o(pole_late)
  );
  pearl_fixed_multiply #(
      .SHIFT(34)
  ) u_reaction (
      .clk_i,
      .a_i(pole_late),
      .b_i(swing),
      .product_o(reaction)
  );
  pearl_delay #(
      .WIDTH (32),
      .STAGES(AT_REACTION - AT_PUSH)
  ) u_push_late (
      .clk_i,
      .d_i(push),
      .d_o(push_late)
  );

  // Velocities have three fraction bits less than their changes.
  fixed_t kick_q, swing_late, swing_q;
  pearl_delay #(
      .WIDTH (32),
      .STAGES(MULTIPLY_LATENCY)
  ) u_swing_late (
      .clk_i,
      .d_i(swing),
      .d_o(swing_late)
  );
  always_ff @(posedge clk_i) begin
    kick_q  <= (push_late - reaction + 32'sd4) >>> 3;
    swing_q <= (swing_late + 32'sd4) >>> 3;
  end

  state_t carried, after_q;
  logic hold_last;
  pearl_delay #(
      .WIDTH (STATE_BITS + 1),
      .STAGES(AT_KICK - AT_MOVED)
  ) u_carried (
      .clk_i,
      .d_i({hold_q, angular_velocity_q, turned_q, velocity_q, moved_q}),
      .d_o({hold_last, carried})
  );
  always_ff @(posedge clk_i) begin
    after_q.position <= carried.position;
    after_q.velocity <= hold_last ? carried.velocity : saturate(33'(carried.velocity) + 33'(kick_q));
    after_q.angle <= carried.angle;
    after_q.angular_velocity <= hold_last ? carried.angular_velocity : saturate(
        33'(carried.angular_velocity) + 33'(swing_q)
    );
    terminated_q <= carried.position > TRACK || carried.position < -TRACK ||
        carried.angle > LEAN || carried.angle < -LEAN;
  end

  assign valid_o = valid_q[LATENCY-1];
  assign state_o = after_q;
  assign obs_o = after_q;
  assign reward_o = SUTTON_BARTO_REWARD && terminated_q;
  assign terminated_o = terminated_q;

endmodule
