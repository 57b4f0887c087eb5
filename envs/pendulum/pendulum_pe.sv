// The core of Pendulum: step.py in hardware, with its names. Pipelined, a slot a cycle.

// verilator lint_off DECLFILENAME
package pendulum_pkg;
  // verilator lint_on DECLFILENAME

  import pearl_fixed_pkg::*;

  // Start | sine | its pull | speed | turn | angle | sine and cosine of the next angle.
  localparam int unsigned LATENCY = 3 + 2 * SINE_COSINE_LATENCY + 2 * MULTIPLY_LATENCY;
  localparam int unsigned II = 1;

  localparam int unsigned STATE_BITS = 64;
  localparam int unsigned ACTION_BITS = 32;
  localparam int unsigned OBS_BITS = 96;
  localparam int unsigned REWARD_BITS = 32;

  // A state word, the first field of the spec last.
  typedef struct packed {
    fixed_t speed;
    fixed_t angle;
  } state_t;

endpackage

module pendulum_pe
  import pendulum_pkg::*;
  import pearl_fixed_pkg::*;
#(
    // `fall` of step.py: what gravity adds to the speed in a step, where the sine is 1. Here g = 10.
    parameter fixed_t FALL = 32'sd100663296
) (
    input logic                clk_i,
    input logic                rst_ni,
    input logic                valid_i,
    // Start from the initial state, not from state_i.
    input logic                first_i,
    // Do not step: the result is the state started from and its observation.
    input logic                hold_i,
    input state_t              state_i,
    input logic   [31:0]       action_i,
    // The random draws of this slot and step, those for the initial state first.
    input logic   [ 1:0][31:0] rng_i,

    output logic          valid_o,
    output state_t        state_o,
    output logic   [95:0] obs_o,
    output logic   [31:0] reward_o,
    output logic          terminated_o
);

  // The constants of step.py.
  localparam fixed_t SPEED = 32'sd1073741824;
  localparam fixed_t TORQUE = 32'sd1073741824;
  localparam fixed_t KICK = 32'sd1288490189;
  localparam fixed_t TURN = 32'sd1093704441;
  localparam fixed_t RADIANS = 32'sd1686629713;
  localparam fixed_t SPEED_COST = 32'sd1717986918;
  localparam fixed_t TORQUE_COST = 32'sd1099511628;

  // Cycles after the inputs at which things are known.
  localparam int unsigned AT_FROM = 1;
  localparam int unsigned AT_KICK = AT_FROM + MULTIPLY_LATENCY;
  localparam int unsigned AT_COST = AT_FROM + 2 * MULTIPLY_LATENCY + 1;
  localparam int unsigned AT_SINE = AT_FROM + SINE_COSINE_LATENCY;
  localparam int unsigned AT_PULL = AT_SINE + MULTIPLY_LATENCY;
  localparam int unsigned AT_SPEED = AT_PULL + 1;
  localparam int unsigned AT_TURN = AT_SPEED + MULTIPLY_LATENCY;
  localparam int unsigned AT_ANGLE = AT_TURN + 1;

  logic [LATENCY-1:0] valid_q;
  always_ff @(posedge clk_i or negedge rst_ni) begin
    if (!rst_ni) valid_q <= '0;
    else valid_q <= {valid_q[LATENCY-2:0], valid_i};
  end

  // Where the slot starts from, and the torque within its limits.
  state_t from_q;
  fixed_t torque_q;
  logic   hold_q;

  always_ff @(posedge clk_i) begin
    hold_q <= hold_i;
    from_q.angle <= first_i ? rng_i[0] : state_i.angle;
    from_q.speed <= first_i ? fixed_t'(rng_i[1]) >>> 4 : state_i.speed;
    if (fixed_t'(action_i) > TORQUE) torque_q <= TORQUE;
    else if (fixed_t'(action_i) < -TORQUE) torque_q <= -TORQUE;
    else torque_q <= fixed_t'(action_i);
  end

  // The reward: three squares.
  fixed_t radians, angle_cost, speed_part, speed_late, speed_cost, torque_part, torque_late, torque_cost;
  fixed_t reward_q;

  pearl_fixed_multiply #(
      .SHIFT(31)
  ) u_radians (
      .clk_i,
      .a_i(from_q.angle),
      .b_i(RADIANS),
      .product_o(radians)
  );
  pearl_fixed_multiply #(
      .SHIFT(32)
  ) u_angle_cost (
      .clk_i,
      .a_i(radians),
      .b_i(radians),
      .product_o(angle_cost)
  );
  pearl_fixed_multiply #(
      .SHIFT(31)
  ) u_speed_part (
      .clk_i,
      .a_i(from_q.speed),
      .b_i(SPEED_COST),
      .product_o(speed_part)
  );
  pearl_fixed_multiply #(
      .SHIFT(31)
  ) u_speed_cost (
      .clk_i,
      .a_i(speed_part),
      .b_i(speed_late),
      .product_o(speed_cost)
  );
  pearl_fixed_multiply #(
      .SHIFT(31)
  ) u_torque_part (
      .clk_i,
      .a_i(torque_q),
      .b_i(TORQUE_COST),
      .product_o(torque_part)
  );
  pearl_fixed_multiply #(
      .SHIFT(41)
  ) u_torque_cost (
      .clk_i,
      .a_i(torque_part),
      .b_i(torque_late),
      .product_o(torque_cost)
  );
  pearl_delay #(
      .WIDTH (64),
      .STAGES(MULTIPLY_LATENCY)
  ) u_factors (
      .clk_i,
      .d_i({from_q.speed, torque_q}),
      .d_o({speed_late, torque_late})
  );
  always_ff @(posedge clk_i) reward_q <= -(angle_cost + speed_cost + torque_cost);
  pearl_delay #(
      .WIDTH (32),
      .STAGES(LATENCY - AT_COST)
  ) u_reward (
      .clk_i,
      .d_i(reward_q),
      .d_o(reward_o)
  );

  // The next speed.
  fixed_t kick, kick_late, sine, unused_cosine, pull, speed_q;
  logic signed [33:0] speed_d;
  state_t from_late;
  logic hold_late;

  pearl_fixed_multiply #(
      .SHIFT(35)
  ) u_kick (
      .clk_i,
      .a_i(torque_q),
      .b_i(KICK),
      .product_o(kick)
  );
  pearl_delay #(
      .WIDTH (32),
      .STAGES(AT_PULL - AT_KICK)
  ) u_kick_late (
      .clk_i,
      .d_i(kick),
      .d_o(kick_late)
  );
  pearl_sine_cosine u_sine (
      .clk_i,
      .turns_i (from_q.angle),
      .sine_o  (sine),
      .cosine_o(unused_cosine)
  );
  pearl_fixed_multiply #(
      .SHIFT(30)
  ) u_pull (
      .clk_i,
      .a_i(sine),
      .b_i(FALL),
      .product_o(pull)
  );
  pearl_delay #(
      .WIDTH (STATE_BITS + 1),
      .STAGES(AT_PULL - AT_FROM)
  ) u_from (
      .clk_i,
      .d_i({hold_q, from_q}),
      .d_o({hold_late, from_late})
  );
  assign speed_d = 34'(from_late.speed) + 34'(pull) + 34'(kick_late);

  always_ff @(posedge clk_i) begin
    if (hold_late) speed_q <= from_late.speed;
    else if (speed_d > 34'(SPEED)) speed_q <= SPEED;
    else if (speed_d < -34'(SPEED)) speed_q <= -SPEED;
    else speed_q <= speed_d[31:0];
  end

  // The next angle, with the next speed.
  fixed_t turn, angle_late, speed_after, angle_q;
  logic hold_last;

  pearl_fixed_multiply #(
      .SHIFT(32)
  ) u_turn (
      .clk_i,
      .a_i(speed_q),
      .b_i(TURN),
      .product_o(turn)
  );
  pearl_delay #(
      .WIDTH (33),
      .STAGES(AT_TURN - AT_PULL)
  ) u_angle (
      .clk_i,
      .d_i({hold_late, from_late.angle}),
      .d_o({hold_last, angle_late})
  );
  always_ff @(posedge clk_i) angle_q <= hold_last ? angle_late : angle_late + turn;

  // What is seen of it.
  state_t after;
  fixed_t sine_after, cosine_after;

  pearl_sine_cosine u_observe (
      .clk_i,
      .turns_i (angle_q),
      .sine_o  (sine_after),
      .cosine_o(cosine_after)
  );
  pearl_delay #(
      .WIDTH (32),
      .STAGES(AT_ANGLE - AT_SPEED)
  ) u_speed_after (
      .clk_i,
      .d_i(speed_q),
      .d_o(speed_after)
  );
  pearl_delay #(
      .WIDTH (STATE_BITS),
      .STAGES(SINE_COSINE_LATENCY)
  ) u_after (
      .clk_i,
      .d_i({speed_after, angle_q}),
      .d_o(after)
  );

  assign valid_o = valid_q[LATENCY-1];
  assign state_o = after;
  assign obs_o = {after.speed, sine_after, cosine_after};
  // It never ends.
  assign terminated_o = 1'b0;

endmodule
