// SPDX-License-Identifier: MIT
// What pearl_vc707 takes from Vivado, as black boxes: the ports are those that the cores and primitives
// have there, for tools that have to know them.

// Boxes are black, and all in one file.
// verilator lint_off UNUSEDSIGNAL
// verilator lint_off UNDRIVEN
// verilator lint_off UNUSEDPARAM
// verilator lint_off DECLFILENAME

// DMA/Bridge Subsystem for PCI Express (PG195): memory-mapped, 128 bits, x8, MSI.
(* blackbox *)
module pearl_xdma (
    input logic sys_clk,
    input logic sys_rst_n,
    output logic user_lnk_up,
    output logic [7:0] pci_exp_txp,
    output logic [7:0] pci_exp_txn,
    input logic [7:0] pci_exp_rxp,
    input logic [7:0] pci_exp_rxn,
    output logic axi_aclk,
    output logic axi_aresetn,
    input logic usr_irq_req,
    output logic usr_irq_ack,
    output logic msi_enable,
    output logic [2:0] msi_vector_width,
    output logic [3:0] m_axi_awid,
    output logic [63:0] m_axi_awaddr,
    output logic [7:0] m_axi_awlen,
    output logic [2:0] m_axi_awsize,
    output logic [1:0] m_axi_awburst,
    output logic m_axi_awlock,
    output logic [3:0] m_axi_awcache,
    output logic [2:0] m_axi_awprot,
    output logic m_axi_awvalid,
    input logic m_axi_awready,
    output logic [3:0] m_axi_arid,
    output logic [63:0] m_axi_araddr,
    output logic [7:0] m_axi_arlen,
    output logic [2:0] m_axi_arsize,
    output logic [1:0] m_axi_arburst,
    output logic m_axi_arlock,
    output logic [3:0] m_axi_arcache,
    output logic [2:0] m_axi_arprot,
    output logic m_axi_arvalid,
    input logic m_axi_arready,
    output logic [127:0] m_axi_wdata,
    output logic [15:0] m_axi_wstrb,
    output logic m_axi_wlast,
    output logic m_axi_wvalid,
    input logic m_axi_wready,
    input logic [3:0] m_axi_bid,
    input logic [1:0] m_axi_bresp,
    input logic m_axi_bvalid,
    output logic m_axi_bready,
    input logic [3:0] m_axi_rid,
    input logic [127:0] m_axi_rdata,
    input logic [1:0] m_axi_rresp,
    input logic m_axi_rlast,
    input logic m_axi_rvalid,
    output logic m_axi_rready
);
endmodule

// AXI Data Width Converter (PG059): 128 to 256 bits, a FIFO with two clocks.
(* blackbox *)
module pearl_upsizer (
    input logic s_axi_aclk,
    input logic s_axi_aresetn,
    input logic [3:0] s_axi_awid,
    input logic [31:0] s_axi_awaddr,
    input logic [7:0] s_axi_awlen,
    input logic [2:0] s_axi_awsize,
    input logic [1:0] s_axi_awburst,
    input logic s_axi_awlock,
    input logic [3:0] s_axi_awcache,
    input logic [2:0] s_axi_awprot,
    input logic [3:0] s_axi_awregion,
    input logic [3:0] s_axi_awqos,
    input logic s_axi_awvalid,
    output logic s_axi_awready,
    input logic [3:0] s_axi_arid,
    input logic [31:0] s_axi_araddr,
    input logic [7:0] s_axi_arlen,
    input logic [2:0] s_axi_arsize,
    input logic [1:0] s_axi_arburst,
    input logic s_axi_arlock,
    input logic [3:0] s_axi_arcache,
    input logic [2:0] s_axi_arprot,
    input logic [3:0] s_axi_arregion,
    input logic [3:0] s_axi_arqos,
    input logic s_axi_arvalid,
    output logic s_axi_arready,
    input logic [127:0] s_axi_wdata,
    input logic [15:0] s_axi_wstrb,
    input logic s_axi_wlast,
    input logic s_axi_wvalid,
    output logic s_axi_wready,
    output logic [3:0] s_axi_bid,
    output logic [1:0] s_axi_bresp,
    output logic s_axi_bvalid,
    input logic s_axi_bready,
    output logic [3:0] s_axi_rid,
    output logic [127:0] s_axi_rdata,
    output logic [1:0] s_axi_rresp,
    output logic s_axi_rlast,
    output logic s_axi_rvalid,
    input logic s_axi_rready,
    input logic m_axi_aclk,
    input logic m_axi_aresetn,
    output logic [31:0] m_axi_awaddr,
    output logic [7:0] m_axi_awlen,
    output logic [2:0] m_axi_awsize,
    output logic [1:0] m_axi_awburst,
    output logic m_axi_awlock,
    output logic [3:0] m_axi_awcache,
    output logic [2:0] m_axi_awprot,
    output logic [3:0] m_axi_awregion,
    output logic [3:0] m_axi_awqos,
    output logic m_axi_awvalid,
    input logic m_axi_awready,
    output logic [31:0] m_axi_araddr,
    output logic [7:0] m_axi_arlen,
    output logic [2:0] m_axi_arsize,
    output logic [1:0] m_axi_arburst,
    output logic m_axi_arlock,
    output logic [3:0] m_axi_arcache,
    output logic [2:0] m_axi_arprot,
    output logic [3:0] m_axi_arregion,
    output logic [3:0] m_axi_arqos,
    output logic m_axi_arvalid,
    input logic m_axi_arready,
    output logic [255:0] m_axi_wdata,
    output logic [31:0] m_axi_wstrb,
    output logic m_axi_wlast,
    output logic m_axi_wvalid,
    input logic m_axi_wready,
    input logic [1:0] m_axi_bresp,
    input logic m_axi_bvalid,
    output logic m_axi_bready,
    input logic [255:0] m_axi_rdata,
    input logic [1:0] m_axi_rresp,
    input logic m_axi_rlast,
    input logic m_axi_rvalid,
    output logic m_axi_rready
);
endmodule

// Primitives of the 7 series (UG953).
(* blackbox *)
module IBUFDS_GTE2 (
    input  logic I,
    input  logic IB,
    input  logic CEB,
    output logic O,
    output logic ODIV2
);
endmodule

(* blackbox *)
module IBUF (
    input  logic I,
    output logic O
);
endmodule

(* blackbox *)
module BUFG (
    input  logic I,
    output logic O
);
endmodule

(* blackbox *)
module PLLE2_BASE #(
    // In nanoseconds; Vivado's is a real, which sv-elab does not take for a black box.
    parameter int CLKIN1_PERIOD  = 0,
    parameter int CLKFBOUT_MULT  = 5,
    parameter int CLKOUT0_DIVIDE = 1
) (
    input  logic CLKIN1,
    input  logic CLKFBIN,
    output logic CLKFBOUT,
    output logic CLKOUT0,
    output logic CLKOUT1,
    output logic CLKOUT2,
    output logic CLKOUT3,
    output logic CLKOUT4,
    output logic CLKOUT5,
    output logic LOCKED,
    input  logic PWRDWN,
    input  logic RST
);
endmodule
